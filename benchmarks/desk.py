"""What a frame of the desk costs while a handle is dragged, on the shipped measurement of 2,000 lines, in Chromium.

`python benchmarks/desk.py [FRAMES]` prints the CPU time of the page's main thread a frame, by Chromium's own counters,
which a busy machine changes little, and the intervals between frames on the clock, which it changes much. What is drawn
is then put on the screen by other threads and a graphics card, which a headless browser does not have: that is not in
it. No test asserts a time.
"""

import re
import shutil
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "lib"))

import numpy as np  # noqa: E402
from selenium import webdriver  # noqa: E402
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.support.ui import WebDriverWait  # noqa: E402

from stillwork.design.desk_page import offline_page, shipped_machines  # noqa: E402

SWITCHES = ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage")
BUDGET_MS = 1000 / 60
WARMUP = 20  # steps before those that count
# A step of a drag in each frame, as a handle's own pointer makes it, faster than a driver can move a mouse.
DRAG = """
const [steps, done] = arguments, desk = deskModules["main.js"].desk, first = desk.design, times = [];
const next = (time) => {
  times.push(time);
  if (times.length > steps) {
    desk.settle(first);
    done(times);
    return;
  }
  const factor = 1 + 0.3 * Math.sin(times.length / 9);
  const blocks = first.blocks.map((block) => (block.kind === "pid" ? { ...block, gain: block.gain * factor, differentiator_hz: block.differentiator_hz * factor } : block));
  desk.hold({ ...first, blocks });
  requestAnimationFrame(next);
};
requestAnimationFrame(next);
"""


def counters(driver: webdriver.Chrome) -> dict[str, float]:
    """CPU seconds of the main thread since the page began: all of it, and by kind."""
    found = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return {each["name"]: each["value"] for each in found}


def main(steps: str = "240") -> None:
    """Drag, count, and print."""
    machines = shipped_machines(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "desk.html"
        page.write_text(offline_page(machines), encoding="utf-8")
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium") or shutil.which("google-chrome")
        for switch in (*SWITCHES, f"user-data-dir={folder}/profile"):
            options.add_argument(f"--{switch}")
        driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
        try:
            driver.set_window_size(1440, 1000)
            driver.get(page.as_uri())
            ready = "return document.getElementById('desk').dataset.ready"
            WebDriverWait(driver, 120).until(lambda _: driver.execute_script(ready))
            notes = driver.execute_script("return document.getElementById('desk-notes').textContent")
            driver.set_script_timeout(300)
            driver.execute_async_script(DRAG, WARMUP)
            driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
            before = counters(driver)
            times = np.diff(driver.execute_async_script(DRAG, int(steps)))
            after = counters(driver)
        finally:
            driver.quit()
    lines = re.search(r"(\d+) lines on the page", notes)
    frames = len(times)
    spent = {name: 1e3 * (after[name] - before[name]) / frames for name in after if name.endswith("Duration")}
    parts = {
        "script": spent["ScriptDuration"],
        "style and layout": spent["RecalcStyleDuration"] + spent["LayoutDuration"],
    }
    parts["paint and the rest"] = spent["TaskDuration"] - sum(parts.values())
    said = ", ".join(f"{name} {size:.2f}" for name, size in parts.items())
    print(f"{machines[0]['name']}, {lines[1] if lines else '?'} lines, {frames} frames")
    print(f"CPU of the main thread a frame: {spent['TaskDuration']:.2f} ms of {BUDGET_MS:.1f} ({said})")
    print(f"between frames: median {np.median(times):.1f} ms, 95 % below {np.quantile(times, 0.95):.1f} ms")


if __name__ == "__main__":
    main(*sys.argv[1:2])
