// The desk in a cell of Jupyter: the page's body and style in a shadow of their own, what is designed shared with Python.
import { toDb } from "./complex.js";
import { controllerToml } from "./export.js";
import { FUNCTIONS } from "./loop.js";
import { startDesk } from "./ui.js";

const peaks = (stable, judged) => (stable && judged ? Object.fromEntries(FUNCTIONS.map((name) => [name, toDb(judged[name].size)])) : null);

function controllerOf(machine, design) {
  try {
    return controllerToml(machine, design);
  } catch {
    return ""; // without a sampling block it is none that runs
  }
}

// A view of a model of the traits of `DeskWidget`; what is returned ends it.
export function render({ model, el }, body, style) {
  const host = document.createElement("div"), shadow = host.attachShadow({ mode: "open" });
  host.style.containerType = "inline-size";
  host.dataset.lmSuppressShortcuts = "true"; // keys that are typed here are none of JupyterLab's
  shadow.innerHTML = `<style>${style.replaceAll("@media (max-width", "@container (max-width")}</style>${body}`;
  el.append(host);
  let desk = null;
  const shared = new WeakSet(), contents = (machine) => JSON.stringify([machine?.model, machine?.measured]);
  const kept = () => {
    const design = model.get("design"), machine = model.get("machine");
    return Array.isArray(design?.blocks) ? { machine, design, whole: model.get("machines").find((each) => each.name === machine) } : null;
  };
  // A machine of a file that was dropped is for the other views, too, and for those that come.
  const share = (machine) => {
    if (shared.has(machine)) return;
    shared.add(machine);
    const known = model.get("machines"), same = known.find((each) => each.name === machine.name);
    if (contents(same) !== contents(machine)) model.set("machines", [...known.filter((each) => each !== same), machine]);
  };
  const changed = (machine, design, result) => {
    share(machine);
    model.set("machine", machine.name);
    model.set("design", design);
    model.set("controller", result ? controllerOf(machine, design) : "");
    model.set("reached", !result ? {} : {
      stable: result.stable,
      bandwidth_hz: result.bandwidth > 0 ? result.bandwidth : null,
      peaks_db: peaks(result.stable, result.nominal),
      peaks_in_box_db: peaks(result.stable, result.box),
      whole_box: Boolean(result.box?.exact),
    });
    model.save_changes();
  };
  const given = () => {
    const found = kept();
    if (found) desk?.take(found);
  };
  // A cell's output has a size only when it is on the page.
  const sized = new ResizeObserver(() => {
    if (!host.clientWidth) return;
    if (desk) desk.resize();
    else desk = startDesk(shadow.querySelector(".desk"), model.get("machines"), { kept: kept(), changed });
  });
  sized.observe(host);
  model.on("change:design", given);
  return () => {
    sized.disconnect();
    model.off("change:design", given);
    desk?.stop();
  };
}
