// The page: blocks to add, drag and type, and everything that follows from them, live.
import { toDb } from "./complex.js";
import { bandwidthText, controllerJson, designText } from "./export.js";
import { BELOW, DRIVE_UNITS, RESPONSE_UNITS, designOfController, machineOfJson, machineOfTable, measuredAlone } from "./files.js";
import { FUNCTIONS, SHOWN, addPlace, boxSearch, judge, makeLoop } from "./loop.js";
import { makeSearch, stableFirstDesign } from "./optimise.js";
import { makePlot, palette, shortNumber, svgOf } from "./plots.js";
import { BLOCKS, timing } from "./response.js";
import { simulate, thirdOrderMove } from "./simulate.js";
import { fromAddress, makeHistory, newBlock, toAddress, typedNumber } from "./state.js";

const IDLE = 250; // ms without a change before the whole box is searched
const TIME_FRAMES = 100; // ms between two simulations during a drag, at least
const MOST_PLACES = 12; // of the box that are kept beside its corners
const MOST_SAMPLES = 20000; // of a step or a scan
const MOVE = { distance: 0.01, velocity: 0.1, acceleration: 2, jerk: 200, feedforward: true };
const REFUSED = "the design that was given has a block of no known kind, or one that lacks numbers or has impossible ones; the desk keeps its own";
const ALTOGETHER = ["magnitude", "phase", "functions", "nyquist", "process", "step", "scan"];

// What a handle moves: the number along the frequency, and the one along the magnitude with its exponent.
const HANDLES = {
  gain: [{ x: null, y: "value", power: 1, label: "gain" }],
  pid: [
    { x: "integrator_hz", y: null, label: "integrator" },
    { x: "differentiator_hz", y: "gain", power: 1, label: "PID" },
    { x: "low_pass_hz", y: "damping", power: -1, label: "low-pass" },
  ],
  lead: [{ x: "zero_hz", y: null, label: "lead zero" }, { x: "pole_hz", y: null, label: "lead pole" }],
  lag: [{ x: "zero_hz", y: null, label: "lag zero" }, { x: "pole_hz", y: null, label: "lag pole" }],
  integrator: [{ x: "zero_hz", y: null, label: "integrator" }],
  notch: [{ x: "frequency_hz", y: "depth", power: 1, label: "notch" }],
  low_pass_1: [{ x: "corner_hz", y: null, label: "low-pass" }],
  low_pass_2: [{ x: "corner_hz", y: "damping", power: -1, label: "low-pass" }],
};

export function startDesk(root, machines) {
  const by = (name) => root.querySelector(`#desk-${name}`);
  const focused = () => document.activeElement;
  const make = (tag, attributes = {}, ...children) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (value === true) element.setAttribute(name, "");
      else if (value !== false && value !== null) element.setAttribute(name, value);
    }
    element.append(...children);
    return element;
  };
  const completed = (each) => (each.model ? each : measuredAlone(each));
  machines = machines.map(completed);
  const kept = fromAddress(location.hash);
  let machine = machines.find((each) => each.name === kept?.machine) ?? machines[0];
  // Beyond the bounds of the fields a number is still one that can be computed with; below zero it is not.
  const sound = (value, { low, high, whole }) => Number.isFinite(value) && (low > 0 ? value > 0 : value >= 0) && (!whole || (Number.isInteger(value) && value >= low && value <= high));
  const usableBlock = (block) =>
    Object.hasOwn(BLOCKS, block?.kind) && Object.entries(BLOCKS[block.kind].numbers).every(([name, about]) => sound(block[name], about)) && Array.isArray(block.fixed ?? []);
  const usable = (design) =>
    design.blocks.every(usableBlock) &&
    ["sampling", "observer"].every((kind) => design.blocks.filter((block) => block.kind === kind).length <= 1) &&
    (design.limit ?? null) === (design.limit > 0 && Number.isFinite(design.limit) ? design.limit : null);
  const whole = (found) => (found && usable(found.design) ? found : null);
  const begun = kept?.machine === machine.name && usable(kept.design) ? { design: kept.design, words: [] } : stableFirstDesign(machine);
  let history = makeHistory(begun.design);
  // A design whose machine is not on the page: it waits for its file.
  let waiting = machines.some((each) => each.name === kept?.machine) ? null : whole(kept);
  const askForFile = () => waiting && say(`the address holds a design for ${waiting.machine}: drop that file here again, and it is restored`);
  let pinned = null, ghost = null, loops = new Map(), result = null, search = null, boxTimer = 0, dropped = null, shownUnits = "", timeAgain = 0, timed = "", turns = 0;
  let colours = palette(root);
  const plots = Object.fromEntries(ALTOGETHER.map((name) => [name, makePlot(by(name), { title: by(name).closest("figure").querySelector("figcaption").firstChild.textContent.trim(), equal: name === "nyquist" })]));

  // --- what is computed ---

  const loopOf = (design) => {
    const { sampleTime, delay, observer } = timing(design);
    const key = JSON.stringify([machine.name, sampleTime, delay, observer]);
    if (!loops.has(key)) {
      if (loops.size > 3) loops.delete(loops.keys().next().value);
      loops.set(key, makeLoop(machine, design));
    }
    return loops.get(key);
  };
  let frame = 0;
  const request = () => {
    frame ||= requestAnimationFrame(() => {
      frame = 0;
      refresh();
    });
  };

  function refresh() {
    const began = performance.now(), design = history.now;
    try {
      result = judge(loopOf(design), design);
      result.design = design;
      warn("");
    } catch (error) {
      warn(error.message);
      return;
    }
    const before = pinned ?? (history.now !== history.settled ? history.settled : null);
    if (before !== ghost?.design) {
      ghost = null;
      try {
        if (before) ghost = { design: before, ...judge(loopOf(before), before, { places: false }) };
      } catch {
        ghost = null; // it was none that could be computed
      }
    }
    paint();
    showFigures();
    showHandles();
    root.dataset.milliseconds = (performance.now() - began).toFixed(2);
    clearTimeout(boxTimer);
    boxTimer = setTimeout(searchBox, IDLE);
  }

  // The whole box, in slices, while nothing moves.
  function searchBox() {
    describe();
    if (search || !result?.box || !machine.model || history.now !== history.settled) return;
    const mine = result, loop = loopOf(mine.design), whole = boxSearch(loop, mine.sections);
    const slice = () => {
      if (mine !== result) return;
      if (!whole.step(8)) {
        setTimeout(slice);
        return;
      }
      for (const [name, each] of Object.entries(whole.results())) {
        if (!(each.size >= mine.box[name].size)) continue;
        mine.box[name] = each;
        if (each.place && loop.places.length < loop.firstPlaces + MOST_PLACES) addPlace(loop, each.place);
      }
      mine.box.exact = true;
      showFigures();
      describe();
    };
    loop.firstPlaces ??= loop.places.length;
    setTimeout(slice);
  }

  // --- what is drawn ---

  // Loops written out: they run over every line at every frame.
  const decibels = (values) => {
    const found = new Float64Array(values.length);
    for (let k = 0; k < found.length; k++) found[k] = 20 * Math.log10(values[k]);
    return found;
  };
  const sizes = ({ re, im }) => {
    const found = new Float64Array(re.length);
    for (let k = 0; k < found.length; k++) found[k] = 10 * Math.log10(re[k] * re[k] + im[k] * im[k]);
    return found;
  };
  // From -270 to 90 degrees: a loop of a mass and a PID begins at -270.
  const phases = ({ re, im }) => {
    const found = new Float64Array(re.length);
    for (let k = 0; k < found.length; k++) {
      const angle = (Math.atan2(im[k], re[k]) * 180) / Math.PI;
      found[k] = angle > 90 ? angle - 360 : angle;
    }
    return found;
  };
  const hertz = (omega) => (omega.hertz ??= Float64Array.from(omega, (w) => w / (2 * Math.PI)));

  function paint() {
    const loop = loopOf(result.design), main = result.main, f = hertz(result.omega), ends = { low: f[0], high: f[f.length - 1] };
    const x = { ...ends, log: true, label: "frequency (Hz)" };
    const before = ghost && { f: hertz(ghost.omega), ...ghost.main };
    const grey = (ys) => ({ x: before.f, y: ys, colour: colours.ghost, width: 1.3, name: "before", dash: [5, 3] });
    // While a hand drags, phase, Nyquist and process sensitivity take turns: the screen is drawn 60 times a second.
    const resting = history.now === history.settled, turn = (turns += 1) % 3, due = (k) => resting || turn === k;
    const draw = (name, axes, content) => {
      plots[name].frame(...axes);
      plots[name].paint(content, colours);
    };
    const own = sizes(main.loop), series = [{ x: f, y: own, colour: colours.blue, name: loop.measured ? "on the measurement" : "on the model" }];
    if (loop.measured && result.model) {
      series.push({ x: hertz(loop.model.omega), y: sizes(result.model.loop), colour: colours.sky, width: 1, name: "on the model", dash: [2, 2] });
    }
    if (before) series.push(grey(sizes(before.loop)));
    draw("magnitude", [x, { low: -60, high: 60, label: "magnitude (dB)" }], { series, bands: loopBand(loop, main), rules: [{ y: 0, colour: colours.soft }] });
    if (due(0)) {
      const turned = [{ x: f, y: phases(main.loop), colour: colours.blue, wrap: 300 }];
      if (before) turned.push({ ...grey(phases(before.loop)), name: undefined, wrap: 300 });
      draw("phase", [x, { low: -280, high: 100, degrees: true, label: "phase (°)" }], { series: turned, rules: [{ y: -180, colour: colours.soft, dash: [4, 3] }] });
    }
    // The functions.
    const lines = loop.observer
      ? [["input_sensitivity", "S_I", colours.vermillion, []], ["output_sensitivity", "S_O, r to e", colours.blue, []]]
      : [["output_sensitivity", "S_I and S_O, r to e", colours.vermillion, []]];
    const functions = lines.map(([name, title, colour, dash]) => ({ x: f, y: decibels(main[name]), colour, dash, name: title }));
    functions.push({ x: f, y: decibels(main.closed), colour: colours.green, name: "r to y", dash: [2, 2] });
    if (before) functions.push(grey(decibels(before.output_sensitivity)));
    const bands = [];
    if (result.box) {
      const at = hertz(loop.corners[0].omega), base = result.model ?? result.measured, name = "output_sensitivity";
      bands.push({ x: at, low: decibels(base[name]), high: decibels(result.box.band[name]), colour: colours.band });
    }
    draw("functions", [x, { low: -50, high: 25, label: "magnitude (dB)" }], { series: functions, bands, rules: [{ y: 6, colour: colours.ink, dash: [2, 3] }] });
    if (due(1)) paintNyquist(draw, loop, main, before);
    if (due(2)) paintProcess(draw, x, main, before, grey);
    // A simulation takes as long as all else: while a hand drags, step and scan follow in turn, some frames later.
    if (resting || performance.now() > timeAgain) {
      const began = performance.now();
      timed = timed === "step" ? "scan" : "step";
      for (const name of resting ? ["step", "scan"] : [timed]) paintTime(name, loop);
      timeAgain = performance.now() + Math.max(TIME_FRAMES, 8 * (performance.now() - began));
    }
  }

  function paintNyquist(draw, loop, main, before) {
    // The circle around -1 that 6 dB of sensitivity leave out.
    const radius = 10 ** (-6 / 20), around = main.output_loop;
    const curves = [{ x: around.re, y: around.im, colour: colours.blue, name: loop.observer ? "at the output" : "open loop" }];
    if (loop.observer) curves.push({ x: main.loop.re, y: main.loop.im, colour: colours.vermillion, dash: [5, 3], name: "at the input" });
    if (before) curves.push({ x: before.output_loop.re, y: before.output_loop.im, colour: colours.ghost, width: 1.3, dash: [5, 3], name: "before" });
    draw("nyquist", [{ low: -2.5, high: 1, label: "real part" }, { low: -2, high: 2, label: "imaginary part" }], {
      series: curves,
      rules: [{ y: 0, colour: colours.line }, { x: 0, colour: colours.line }],
      circles: [{ x: -1, y: 0, radius, colour: colours.ink, dash: [2, 3] }, { x: -1, y: 0, radius: 0.015, colour: colours.ink }],
      texts: [{ x: -1, y: 0, text: "−1", colour: colours.ink }],
    });
  }

  function paintProcess(draw, x, main, before, grey) {
    const process = decibels(main.process), own0 = [{ x: hertz(result.omega), y: process, colour: colours.blue }];
    let low = Infinity, high = -Infinity;
    for (const value of process) if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
    if (before) own0.push({ ...grey(decibels(before.process)), name: undefined });
    draw("process", [x, { low: Math.max(low, high - 100), high: high + 6, label: `${machine.units.position}/${machine.units.drive} (dB)` }], { series: own0 });
  }

  // Open loops at the corners of the box: the band that the magnitude moves in.
  function loopBand(loop, main) {
    if (!result.box || !loop.model || loop.observer) {
      const gain = (machine.model?.uncertainty ?? machine.uncertainty)?.gain ?? 0;
      if (!gain || !result.box) return [];
      const own = sizes(main.loop);
      return [{ x: hertz(result.omega), low: own.map((y) => y + toDb(1 - gain)), high: own.map((y) => y + toDb(1 + gain)), colour: colours.band }];
    }
    const n = loop.model.omega.length;
    if (!loop.spread || loop.spread.count !== loop.corners.length) {
      // Of the plant alone: it stays while a controller is shaped.
      const low = new Float64Array(n).fill(Infinity), high = new Float64Array(n).fill(-Infinity);
      for (const { plant } of [loop.model, ...loop.corners]) {
        for (let k = 0; k < n; k++) {
          const size = 10 * Math.log10(plant.re[k] ** 2 + plant.im[k] ** 2);
          if (size < low[k]) low[k] = size;
          if (size > high[k]) high[k] = size;
        }
      }
      loop.spread = { low, high, count: loop.corners.length, own: sizes(loop.model.plant) };
    }
    const own = sizes(result.model.loop), { low, high, own: plant } = loop.spread;
    return [{ x: hertz(loop.model.omega), low: own.map((y, k) => y + low[k] - plant[k]), high: own.map((y, k) => y + high[k] - plant[k]), colour: colours.band }];
  }

  const moveOf = (design) => ({ ...MOVE, ...(design.move ?? {}) });

  function timeSeries(kind, loop, design, sections, bandwidth = result.bandwidth) {
    const { sampleTime } = loop;
    const length = kind === "step" ? 10 / Math.max(bandwidth, 1e-3) : 0;
    if (kind === "step") {
      const count = Math.min(Math.ceil(length / sampleTime), MOST_SAMPLES), reference = new Float64Array(count).fill(1);
      const { position } = simulate(loop, sections, reference);
      return { time: position.map((_, k) => k * sampleTime * 1e3), values: position };
    }
    const move = moveOf(design), { position: path, acceleration, duration } = thirdOrderMove(move, sampleTime, 3 / Math.max(bandwidth, 1e-3), loop.delay + sampleTime / 2);
    if (path.length > MOST_SAMPLES) throw new Error(`the scan takes ${path.length} samples, more than ${MOST_SAMPLES}: shorten it`);
    const { position, force } = simulate(loop, sections, path, {
      acceleration,
      feedforward: move.feedforward ? machine.mass : 0,
      limit: design.limit > 0 ? design.limit : Infinity,
    });
    return { time: path.map((_, k) => k * sampleTime * 1e3), values: path.map((r, k) => r - position[k]), duration: duration * 1e3, force };
  }

  function paintTime(name, loop) {
    const plot = plots[name], { position } = machine.units;
    const empty = (text) => {
      plot.frame({ low: 0, high: 1, label: "time (ms)" }, { low: 0, high: 1, label: name === "step" ? `${position}/${position}` : `error (${position})` });
      plot.paint({ texts: [{ x: 0.02, y: 0.5, text, colour: colours.soft }] }, colours);
    };
    if (!loop.machine.model) return empty("needs a fitted model");
    if (!loop.sampleTime) return empty("add a sampling block");
    if (!result.stable) return empty("the loop is not stable");
    let now, then = null;
    try {
      now = timeSeries(name, loop, result.design, result.sections);
      if (ghost?.stable) then = (ghost[name] ??= timeSeries(name, loopOf(ghost.design), ghost.design, ghost.sections, ghost.bandwidth));
    } catch (error) {
      return empty(error.message);
    }
    let low = Infinity, high = -Infinity;
    for (const each of [now, then]) if (each) for (const value of each.values) [low, high] = [Math.min(low, value), Math.max(high, value)];
    const margin = 0.08 * (high - low || 1), series = [{ x: now.time, y: now.values, colour: colours.blue, name: name === "scan" && now.duration ? `peak ${shortNumber(Number(Math.max(...now.values.map(Math.abs)).toPrecision(3)))} ${position}` : undefined }];
    if (then) series.push({ x: then.time, y: then.values, colour: colours.ghost, width: 1.3, dash: [5, 3], name: "before" });
    plot.frame({ low: 0, high: now.time[now.time.length - 1] || 1, label: "time (ms)" }, { low: low - margin, high: high + margin, label: name === "step" ? `y (${position})` : `r − y (${position})` });
    plot.paint({ series, rules: [{ y: name === "step" ? 1 : 0, colour: colours.soft, dash: [4, 3] }, ...(now.duration ? [{ x: now.duration, colour: colours.soft, dash: [2, 3] }] : [])] }, colours);
  }

  // --- figures, lights and words ---

  const figureTexts = () => {
    // Of the loop at the plant's output, as those of `design`.
    const { margins: m } = result, factor = (x) => (Number.isFinite(x) ? `${(10 ** (x / 20)).toPrecision(3)} (${x.toFixed(1)} dB)` : "none");
    return [
      ["bandwidth", result.bandwidth > 0 ? `${result.bandwidth.toPrecision(4)} Hz` : "no crossing"],
      ["loop", stability(), !result.stable],
      ["gain margin", `${factor(m.up)}, down to ${(Number.isFinite(m.down) ? 10 ** (-m.down / 20) : 0).toPrecision(3)}`],
      ["phase margin", Number.isFinite(m.phase) ? `${m.phase.toFixed(1)}°` : "none"],
      ["modulus margin", m.modulus.toFixed(3)],
    ];
  };
  function stability() {
    if (result.unstable) return `unstable (${Math.abs(result.unstable)} pole${Math.abs(result.unstable) === 1 ? "" : "s"})`;
    if (result.extraTurns) return "unstable on the measurement";
    if (result.box?.unstable) return "unstable in the box";
    return result.model ? "stable" : "stable by the lines";
  }
  const light = (each) => {
    if (!result.stable) return ["desk-fail", "✕ not stable"];
    const db = toDb(each.size), text = `${db.toFixed(2)} dB at ${shortNumber(Number(each.hz.toPrecision(4)))} Hz`;
    return db <= 6.01 ? ["desk-pass", `✓ ${text}`] : db <= 7 ? ["desk-near", `▲ ${text}`] : ["desk-fail", `✕ ${text}`];
  };
  const figures = [], lights = [];
  for (const name of FUNCTIONS) {
    const row = make("tr", {}, make("th", { scope: "row" }, SHOWN[name]), make("td"), make("td"));
    by("lights").tBodies[0].append(row);
    lights.push([name, row.cells[1], row.cells[2]]);
  }
  const setText = (element, text) => {
    if (element.textContent !== text) element.textContent = text;
  };
  function showFigures() {
    figureTexts().forEach(([title, text, wrong], k) => {
      if (!figures[k]) {
        const dd = make("dd");
        by("figures").append(make("div", {}, make("dt", {}, title), dd));
        figures.push(dd);
      }
      setText(figures[k], text);
      figures[k].className = wrong ? "desk-wrong" : "";
    });
    setText(by("as-is"), result.measured ? (result.model ? "measured, model" : "measured") : "model");
    const box = result.box;
    setText(by("in-box"), !box ? "in the box" : !machine.model ? "with the gain's box" : box.exact ? "anywhere in the box" : "at corners of the box");
    for (const [name, own, there] of lights) {
      const [kind, text] = light(result.nominal[name]);
      own.className = kind;
      setText(own, text);
      const [boxKind, boxText] = box ? light(box[name]) : ["", "no box"];
      there.className = boxKind;
      setText(there, boxText);
    }
    by("undo").disabled = !history.canUndo;
    by("redo").disabled = !history.canRedo;
  }
  function describe() {
    if (!result) return;
    const words = figureTexts().map(([title, text]) => `${title} ${text}`).join(", ");
    for (const name of ALTOGETHER) by(name).setAttribute("aria-label", `${plots[name].title}. ${words}`);
  }
  function warn(text) {
    const message = by("message");
    if (text) {
      message.textContent = text;
      message.classList.add("desk-wrong");
    } else if (message.classList.contains("desk-wrong")) {
      message.textContent = "";
      message.classList.remove("desk-wrong");
    }
  }
  function say(text) {
    by("message").classList.remove("desk-wrong");
    by("message").textContent = text;
  }

  // --- changes ---

  function remember() {
    if (waiting?.machine === machine.name) waiting = { ...waiting, design: history.now }; // its file is here: dropped again, it gets what is shown
    try {
      globalThis.history.replaceState(null, "", toAddress(machine.name, history.now));
    } catch {
      // some browsers change an address only so often in half a minute
    }
  }
  function settle(design) {
    history.put(design);
    remember();
    showBlocks();
    request();
  }
  function hold(design) {
    history.hold(design);
    showBlocks();
    request();
  }
  const withBlock = (index, change) => ({ ...history.now, blocks: history.now.blocks.map((block, k) => (k === index ? { ...block, ...change } : block)) });
  const bounded = (kind, name, value) => {
    const { low, high, whole } = BLOCKS[kind].numbers[name], inside = Math.min(Math.max(value, low), high);
    return whole ? Math.round(inside) : inside;
  };

  // --- the list of blocks ---

  let structure = "";
  const fields = new Map();
  function showBlocks() {
    const design = history.now;
    const wanted = JSON.stringify([machine.name, design.blocks.map((block) => block.kind)]);
    if (wanted !== structure) {
      structure = wanted;
      buildBlocks(design);
    }
    design.blocks.forEach((block, index) => {
      for (const name of Object.keys(BLOCKS[block.kind].numbers)) {
        const field = fields.get(`${index}.${name}`);
        if (focused() !== field.input || field.input.getAttribute("aria-invalid") !== "true") {
          if (focused() !== field.input || field.read() !== block[name]) field.input.value = fieldText(block[name]);
          field.input.removeAttribute("aria-invalid");
        }
        if (field.fixed) field.fixed.checked = (block.fixed ?? []).includes(name);
      }
      const card = fields.get(`${index}`);
      card.on.disabled = block.kind === "observer" && !machine.model;
      card.box.classList.toggle("desk-off", Boolean(block.off));
      card.on.checked = !block.off;
      if (card.compensate) card.compensate.checked = Boolean(block.compensate);
    });
    if (focused() !== by("limit")) by("limit").value = design.limit > 0 ? String(design.limit) : "";
    showMove();
  }

  // As it was typed, or six digits of what was computed.
  const fieldText = (value) => (String(value).length <= 10 ? String(value) : String(Number(value.toPrecision(6))));

  const unitOf = (name, unit) => {
    const { position, drive } = machine.units;
    if (name === "value") return "";
    return unit === "force" ? `${drive}/${position}` : unit.replace("acceleration", `${position}/s²`).replace("position", position);
  };

  function buildBlocks(design) {
    fields.clear();
    const cards = design.blocks.map((block, index) => {
      const { title, numbers } = BLOCKS[block.kind], same = design.blocks.slice(0, index + 1).filter((each) => each.kind === block.kind).length;
      const name = design.blocks.filter((each) => each.kind === block.kind).length > 1 ? `${title} ${same}` : title;
      const on = make("input", { type: "checkbox" }), remove = make("button", { type: "button", "aria-label": `Remove ${name}` }, "Remove");
      on.addEventListener("change", () => settle(withBlock(index, { off: !on.checked })));
      remove.addEventListener("click", () => {
        settle({ ...history.now, blocks: history.now.blocks.filter((_, k) => k !== index) });
        by("kind").focus();
      });
      const box = make("fieldset", {}, make("legend", {}, name), make("div", { class: "desk-heads" }, make("label", {}, on, "in the loop"), remove));
      const card = { box, on };
      if (block.kind === "observer") {
        card.compensate = make("input", { type: "checkbox" });
        card.compensate.addEventListener("change", () => settle(withBlock(index, { compensate: card.compensate.checked })));
        box.append(make("div", { class: "desk-heads" }, make("label", {}, card.compensate, "MC: compensate the measurement")));
      }
      fields.set(`${index}`, card);
      if (Object.values(numbers).some((each) => each.free)) box.append(make("p", { class: "desk-fixed", "aria-hidden": "true" }, "fixed"));
      for (const [key, { label, unit, free }] of Object.entries(numbers)) box.append(numberRow(index, block.kind, name, key, label, unitOf(key, unit), free));
      return box;
    });
    by("list").replaceChildren(...cards);
  }

  // ``read(refuse)``: the number in a field, or null; then `refuse` is called with why.
  function numberReader(input, label, wanted, fits) {
    return (refuse = () => {}) => {
      try {
        const value = typedNumber(input.value);
        if (fits(value)) return value;
        refuse(`${label}: give ${wanted}`);
      } catch (error) {
        refuse(`${label}: ${error.message}; give ${wanted}`);
      }
      return null;
    };
  }
  const positive = (input, label, wanted = "a number above 0") => numberReader(input, label, wanted, (value) => value > 0 && value < Infinity);

  function numberRow(index, kind, title, key, label, unit, free) {
    const id = `desk-${index}-${key}`;
    const input = make("input", { type: "text", inputmode: "decimal", id, autocomplete: "off", spellcheck: "false" });
    const fixed = free ? make("input", { type: "checkbox", "aria-label": `Keep ${label} of ${title} in a search`, title: "fixed in a search" }) : null;
    const { low, high, whole } = BLOCKS[kind].numbers[key];
    const read = numberReader(input, label, `a ${whole ? "whole " : ""}number from ${shortNumber(low)} to ${shortNumber(high)}`, (value) => value >= low && value <= high && (!whole || Number.isInteger(value)));
    input.addEventListener("input", () => {
      const value = read();
      if (value === null) input.setAttribute("aria-invalid", "true");
      else input.removeAttribute("aria-invalid");
      // What is no number yet, or no longer, leaves nothing of itself: "1e400" passes through 1e40.
      hold(value === null ? history.settled : withBlock(index, { [key]: value }));
    });
    input.addEventListener("change", () => {
      const value = read(say);
      input.removeAttribute("aria-invalid");
      settle(value === null ? history.settled : withBlock(index, { [key]: value }));
    });
    input.addEventListener("keydown", (event) => {
      const way = { ArrowUp: 1, ArrowDown: -1 }[event.key];
      if (!way) return;
      event.preventDefault();
      const now = history.now.blocks[index][key], step = BLOCKS[kind].numbers[key].whole ? now + way : (now || 1e-3) * (event.shiftKey ? 1.2 : 1.02) ** way;
      settle(withBlock(index, { [key]: bounded(kind, key, step) }));
    });
    fixed?.addEventListener("change", () => {
      const others = (history.now.blocks[index].fixed ?? []).filter((each) => each !== key);
      settle(withBlock(index, { fixed: fixed.checked ? [...others, key] : others }));
    });
    fields.set(`${index}.${key}`, { input, fixed, read });
    return make("div", { class: "desk-number" }, make("label", { for: id }, label, ...(unit ? [" ", make("span", {}, `(${unit})`)] : [])), input, fixed ?? make("span"));
  }

  // --- handles on the magnitude ---

  const space = "http://www.w3.org/2000/svg", handles = by("handles");
  let shownHandles = "", nodes = [], dragging = null;
  function wantedHandles() {
    return history.now.blocks.flatMap((block, index) => (block.off ? [] : (HANDLES[block.kind] ?? []).map((handle) => ({ ...handle, index, kind: block.kind }))));
  }
  const placeOf = (handle) => {
    const plot = plots.magnitude, block = history.now.blocks[handle.index];
    const f = Math.min(Math.max(handle.x ? block[handle.x] : result.bandwidth || 1, plot.x.low), plot.x.high);
    const omega = result.omega, target = 2 * Math.PI * f;
    let low = 0, high = omega.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (omega[middle] < target) low = middle;
      else high = middle;
    }
    const size = toDb(Math.hypot(result.main.loop.re[low], result.main.loop.im[low]));
    return [plot.toX(f), plot.toY(Math.min(Math.max(size, plot.y.low + 5), plot.y.high - 5))];
  };
  function showHandles() {
    const wanted = wantedHandles(), key = JSON.stringify([machine.name, wanted]);
    if (key !== shownHandles) {
      shownHandles = key;
      nodes = wanted.map((handle) => makeHandle(handle));
      handles.replaceChildren(...nodes.map((each) => each.group));
    }
    for (const { group, handle } of nodes) {
      const [x, y] = placeOf(handle), block = history.now.blocks[handle.index];
      group.setAttribute("transform", `translate(${x.toFixed(1)} ${y.toFixed(1)})`);
      const value = handle.x ? block[handle.x] : block[handle.y];
      group.setAttribute("aria-valuenow", String(Number(value.toPrecision(6))));
      const along = handle.x ? `${shortNumber(Number(value.toPrecision(4)))} Hz` : "";
      const upward = handle.y ? `${BLOCKS[handle.kind].numbers[handle.y].label} ${shortNumber(Number(block[handle.y].toPrecision(4)))}` : "";
      group.setAttribute("aria-valuetext", [along, upward].filter(Boolean).join(", "));
    }
  }
  const moved = (handle, block, factorX, decibelsUp) => {
    const change = {};
    if (handle.x) change[handle.x] = bounded(handle.kind, handle.x, block[handle.x] * factorX);
    if (handle.y && decibelsUp) change[handle.y] = bounded(handle.kind, handle.y, (block[handle.y] || 1e-4) * 10 ** ((handle.power * decibelsUp) / 20));
    return change;
  };
  function makeHandle(handle) {
    const svg = (tag, attributes) => {
      const element = document.createElementNS(space, tag);
      for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
      return element;
    };
    const about = BLOCKS[handle.kind].numbers[handle.x ?? handle.y];
    const group = svg("g", { class: "desk-handle", role: "slider", tabindex: "0", "aria-label": `${handle.label} on the open loop`, "aria-valuemin": String(about.low), "aria-valuemax": String(about.high), "aria-orientation": "horizontal" });
    const label = svg("text", { y: -12, "aria-hidden": "true" });
    label.textContent = handle.label;
    group.append(svg("circle", { class: "desk-reach", r: 18 }), svg("circle", { class: "desk-dot", r: 6.5 }), label);
    group.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      group.setPointerCapture(event.pointerId);
      group.focus();
      group.classList.add("desk-dragged");
      dragging = { x: event.clientX, y: event.clientY, block: history.now.blocks[handle.index] };
    });
    group.addEventListener("pointermove", (event) => {
      if (!dragging || !group.hasPointerCapture(event.pointerId)) return;
      const plot = plots.magnitude, at = plot.toX(handle.x ? dragging.block[handle.x] : 1);
      const factor = handle.x ? plot.fromX(at + event.clientX - dragging.x) / dragging.block[handle.x] : 1;
      hold(withBlock(handle.index, moved(handle, dragging.block, factor, (dragging.y - event.clientY) * plot.perPixelY())));
    });
    const end = () => {
      if (!dragging) return;
      dragging = null;
      group.classList.remove("desk-dragged");
      settle(history.now);
    };
    group.addEventListener("pointerup", end);
    group.addEventListener("pointercancel", end);
    group.addEventListener("keydown", (event) => {
      const [across, upward] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], PageUp: [0, 10], PageDown: [0, -10] }[event.key] ?? [0, 0];
      if (!across && !upward) return;
      event.preventDefault();
      const factor = (event.shiftKey ? 1.1 : 1.01) ** across, block = history.now.blocks[handle.index];
      settle(withBlock(handle.index, moved(handle, block, factor, upward * (event.shiftKey ? 1 : 0.1))));
    });
    return { group, handle };
  }

  // --- the scan ---

  const moveFields = {};
  function showMove() {
    const place = by("move"), units = { distance: "", velocity: "/s", acceleration: "/s²", jerk: "/s³" };
    if (!place.children.length) {
      for (const name of Object.keys(units)) {
        const input = make("input", { type: "text", inputmode: "decimal", autocomplete: "off" });
        const read = positive(input, name);
        input.addEventListener("change", () => {
          const value = read(say);
          if (value !== null) settle({ ...history.now, move: { ...moveOf(history.now), [name]: value } });
          input.value = String(moveOf(history.now)[name]);
        });
        const unit = make("span");
        moveFields[name] = { input, unit, over: units[name] };
        place.append(make("label", {}, `${name} `, input, unit));
      }
      const feed = make("input", { type: "checkbox" });
      feed.addEventListener("change", () => settle({ ...history.now, move: { ...moveOf(history.now), feedforward: feed.checked } }));
      moveFields.feedforward = { input: feed };
      place.append(make("label", {}, feed, "mass feedforward"));
    }
    const move = moveOf(history.now);
    for (const [name, { input, unit, over }] of Object.entries(moveFields)) {
      if (name === "feedforward") input.checked = move.feedforward;
      else if (focused() !== input) input.value = String(move[name]);
      if (unit) unit.textContent = `${machine.units.position}${over}`;
    }
  }

  // --- files, exports, the search ---

  function showMachine() {
    by("machine").replaceChildren(...machines.map((each) => make("option", { value: each.name, selected: each === machine }, each.name)));
    const size = `${shortNumber(Number(machine.mass.toPrecision(4)))} ${machine.mass_unit}`, alone = "without a fitted model: the box holds gain and delay alone, and there is no observer";
    const notes = machine.model ? [size] : [machine.rigid === 2 ? size : `it moves as ${size} in its first octave`, alone];
    if (machine.turned) notes.push("counted against the force, turned");
    if (machine.model) {
      const found = machine.model.omega.filter((w) => w > 0).map((w) => (w / (2 * Math.PI)).toPrecision(4));
      notes.push(`resonances at ${found.join(", ")} Hz`);
      const { frequency, gain, damping, residue, mass, delay, friction } = machine.model.uncertainty;
      const most = (values) => Math.max(...values.map((x) => 100 * x));
      const parts = [`resonances ±${most(frequency).toPrecision(2)} %`, `gain ±${(100 * gain).toPrecision(2)} %`];
      if (most(residue) >= 0.01) parts.push(`parts of the modes up to ±${most(residue).toPrecision(2)} %`);
      if (most(damping) >= 0.01) parts.push(`damping up to ±${most(damping).toPrecision(2)} %`);
      if (delay > 1e-9) parts.push(`delay ±${(1e6 * delay).toPrecision(2)} µs`);
      if (mass >= 1e-4) parts.push(`mass ±${(100 * mass).toPrecision(2)} %`);
      if (friction > 0) parts.push(`friction over mass ±${friction.toPrecision(2)} 1/s`);
      notes.push(`the box: ${parts.join(", ")}`);
    }
    if (machine.measured) notes.push(`measured from ${machine.band_hz.map((f) => shortNumber(Number(f.toPrecision(4)))).join(" to ")} Hz, ${machine.measured.hz.length} lines on the page`);
    const list = make("ul", { class: "desk-notes-list" }, ...[...notes, ...machine.notes].map((note) => make("li", {}, note)));
    const children = [list];
    if (!machine.model) {
      const select = make("select", {}, ...BELOW.map((words, rigid) => make("option", { value: String(rigid), selected: rigid === machine.rigid }, words)));
      select.addEventListener("change", () => takeBelow(Number(select.value)));
      const ends = `below ${shortNumber(Number(machine.band_hz[0].toPrecision(4)))} Hz it is taken for`;
      children.push(make("p", { class: "desk-add" }, make("label", {}, `${ends} `, select), ` (${machine.first})`));
    }
    if (dropped && dropped.machine === machine.name && shownUnits) {
      const choose = (label, options, now, key) => {
        const select = make("select", {}, ...options.map((unit) => make("option", { selected: unit === now }, unit)));
        select.addEventListener("change", () => takeTable(dropped.text, dropped.name, { ...dropped.units, [key]: select.value }));
        return make("label", {}, `${label} `, select);
      };
      children.push(make("p", { class: "desk-add" }, choose("response", RESPONSE_UNITS, dropped.units.response ?? "m/s^2", "response"), choose("over", DRIVE_UNITS, dropped.units.drive ?? machine.units.drive, "drive")));
    }
    by("notes").replaceChildren(...children);
    by("limit-unit").textContent = machine.units.drive;
    for (const option of by("kind").options) option.disabled = option.value === "observer" && !machine.model;
  }
  function useMachine(next, design = null) {
    machine = next;
    loops = new Map();
    pinned = ghost = null;
    by("ghost").setAttribute("aria-pressed", "false");
    const begin = design ? { design, words: [] } : stableFirstDesign(machine), { design: first, words } = withoutObserver(begin.design);
    history = makeHistory(first);
    showMachine();
    settle(history.now);
    return [...begin.words, ...words];
  }
  // An observer stays, out of the loop, where no model is there for it.
  function withoutObserver(design) {
    const idle = machine.model ? [] : design.blocks.filter((block) => block.kind === "observer" && !block.off);
    const blocks = design.blocks.map((block) => (idle.includes(block) ? { ...block, off: true } : block));
    return { design: { ...design, blocks }, words: idle.length ? ["its observer is out of the loop: it needs a fitted model"] : [] };
  }
  function takeBelow(rigid) {
    const found = measuredAlone(machine, rigid);
    machines[machines.indexOf(machine)] = found;
    machine = found;
    loops = new Map();
    showMachine();
    request();
  }
  function takeTable(text, name, units = {}) {
    const found = machineOfTable(text, name, units);
    shownUnits = found.notes.some((note) => note.includes("does not say its units")) || Object.keys(units).length ? "yes" : "";
    dropped = { text, name, units, machine: name };
    keepMachine(found);
  }
  function keepMachine(found) {
    const at = machines.findIndex((each) => each.name === found.name);
    if (at >= 0) machines[at] = found;
    else machines.push(found);
    const restored = waiting?.machine === found.name;
    const words = useMachine(found, restored ? waiting.design : null);
    say([`${found.name} is on the desk, with ${restored ? "the design of the address" : "a first design"}`, ...words].join("; "));
  }
  async function takeFile(file) {
    try {
      const text = await file.text();
      if (/\.json$/i.test(file.name)) {
        const whole = machineOfJson(text);
        if (whole) {
          keepMachine(whole);
          return;
        }
        const { design: found, notes } = designOfController(text, machine), { design, words } = withoutObserver(found);
        settle(design);
        say([`${file.name}: its blocks are on the desk`, ...notes, ...words].join("; "));
      } else takeTable(text, file.name);
    } catch (error) {
      warn(`${file.name}: ${error.message}`);
    }
  }
  const download = (name, content, type = "text/plain") => {
    const blob = content instanceof Blob ? content : new Blob([content], { type }), address = URL.createObjectURL(blob);
    const link = make("a", { href: address, download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  };
  const offer = (name, content) => {
    try {
      download(name, content());
      say(`${name} is in your downloads`);
    } catch (error) {
      warn(error.message);
    }
  };

  function best() {
    if (search) {
      search.stopped = true;
      return;
    }
    const before = history.now, from = result?.bandwidth;
    try {
      search = makeSearch(machine, before);
    } catch (error) {
      warn(error.message);
      return;
    }
    const mine = search, own = machine, button = by("best");
    button.textContent = "Stop";
    const slice = () => {
      const changed = machine !== own || history.now !== before;
      let done = mine.stopped || changed;
      try {
        done = done || mine.step(14);
      } catch (error) {
        warn(error.message);
        done = true;
      }
      if (!done) {
        say(`searching: ${Math.round(100 * mine.progress())} %`);
        setTimeout(slice);
        return;
      }
      search = null;
      button.textContent = "Best for this structure";
      if (changed) {
        say("the search has stopped: something else was changed");
        return;
      }
      const { design, holds, seconds } = mine.results();
      if (mine.stopped && !holds) {
        say("stopped; nothing was changed");
        return;
      }
      settle(design);
      refresh();
      const to = result.bandwidth;
      say(holds ? `${from > 0 ? `${from.toFixed(1)} to ` : ""}${bandwidthText(to, 1)} in ${seconds.toFixed(1)} s; all constraints hold` : "nothing was found that holds all constraints: another structure may");
    };
    setTimeout(slice);
  }

  // --- wiring ---

  by("kind").append(...Object.entries(BLOCKS).map(([kind, { title }]) => make("option", { value: kind }, title)));
  by("add").addEventListener("click", () => {
    const kind = by("kind").value, blocks = history.now.blocks;
    if (["sampling", "observer"].includes(kind) && blocks.some((block) => block.kind === kind)) {
      say(`there is one ${BLOCKS[kind].title.toLowerCase()} block already`);
      return;
    }
    const block = newBlock(kind, machine, history.now, result?.bandwidth), at = blocks.findIndex((each) => !HANDLES[each.kind]);
    const next = [...blocks];
    next.splice(HANDLES[kind] && at >= 0 ? at : blocks.length, 0, block);
    settle({ ...history.now, blocks: next });
    fields.get(`${next.indexOf(block)}.${Object.keys(BLOCKS[kind].numbers)[0]}`)?.input.focus();
  });
  const readLimit = positive(by("limit"), "limit", "a number above 0, or nothing");
  by("limit").addEventListener("change", () => {
    const none = by("limit").value.trim() === "", value = none ? null : readLimit(say);
    if (none || value !== null) settle({ ...history.now, limit: value });
    by("limit").value = history.now.limit > 0 ? String(history.now.limit) : "";
  });
  const back = (way) => {
    history[way]();
    remember();
    showBlocks();
    request();
  };
  by("undo").addEventListener("click", () => back("undo"));
  by("redo").addEventListener("click", () => back("redo"));
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey) return;
    const key = event.key.toLowerCase();
    if (key === "z" || key === "y") {
      event.preventDefault();
      back(key === "y" || event.shiftKey ? "redo" : "undo");
    }
  });
  by("ghost").addEventListener("click", () => {
    pinned = pinned ? null : history.now;
    by("ghost").setAttribute("aria-pressed", String(Boolean(pinned)));
    request();
  });
  by("machine").addEventListener("change", () => {
    const words = useMachine(machines.find((each) => each.name === by("machine").value));
    say([`${machine.name} is on the desk, with a first design`, ...words].join("; "));
  });
  by("open").addEventListener("click", () => by("file").click());
  by("file").addEventListener("change", () => {
    const [file] = by("file").files;
    if (file) takeFile(file);
    by("file").value = "";
  });
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, (event) => {
      event.preventDefault();
      root.classList.add("desk-dropping");
    });
  }
  document.addEventListener("dragleave", (event) => root.contains(event.relatedTarget) || root.classList.remove("desk-dropping"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    root.classList.remove("desk-dropping");
    const [file] = event.dataTransfer.files;
    if (file) takeFile(file);
  });
  by("best").addEventListener("click", best);
  by("controller").addEventListener("click", () => offer("controller.json", () => controllerJson(machine, history.now)));
  by("text").addEventListener("click", () => offer("design.txt", () => designText(machine, history.now, result)));
  by("link").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      say("the address, with the design in it, is copied");
    } catch {
      say("the address bar holds the design: copy it from there");
    }
  });
  for (const [name, plot] of Object.entries(plots)) {
    const save = make("span", { class: "desk-save" });
    for (const kind of ["PNG", "SVG"]) {
      const button = make("button", { type: "button", "aria-label": `${plot.title} as ${kind}` }, kind);
      button.addEventListener("click", () => {
        if (kind === "SVG") download(`${name}.svg`, svgOf(plot), "image/svg+xml");
        else plot.canvas.toBlob((blob) => download(`${name}.png`, blob));
      });
      save.append(button);
    }
    plot.canvas.closest("figure").querySelector("figcaption").append(save);
    const over = (event) => {
      const box = plot.canvas.getBoundingClientRect();
      plot.hover = event.type === "pointerleave" ? null : { x: event.clientX - box.left, y: event.clientY - box.top };
      if (!frame) plot.repaint();
    };
    plot.canvas.addEventListener("pointermove", over);
    plot.canvas.addEventListener("pointerleave", over);
  }
  addEventListener("resize", () => {
    Object.values(plots).forEach((plot) => plot.resize());
    request();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours = palette(root);
    request();
  });
  // A design of a machine, {machine, design}, from the address.
  function take(found) {
    if (!usable(found.design)) {
      say(REFUSED);
      return;
    }
    if (JSON.stringify(found.design) === JSON.stringify(history.settled)) return;
    const other = machines.find((each) => each.name === found.machine);
    waiting = other ? null : found;
    if (!other) askForFile();
    else if (other !== machine) useMachine(other, found.design);
    else settle(found.design);
  }
  const fromHash = () => {
    const found = whole(fromAddress(location.hash));
    if (found) take(found);
  };
  addEventListener("hashchange", fromHash);
  Object.values(plots).forEach((plot) => plot.resize());
  showMachine();
  showBlocks();
  refresh();
  describe();
  if (begun.words.length) say(begun.words.join("; "));
  if (kept && !whole(kept)) say(REFUSED);
  askForFile();
  root.dataset.ready = "yes";
  return { get result() { return result; }, get design() { return history.now; }, hold, settle };
}
