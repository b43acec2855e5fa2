// The loop: its functions on the model and on the measurement, the constraints, and the box around the model.
import { complexArray, geomspace, multiplyInto, resonanceGrid, sortedUnique, toDb } from "./complex.js";
import { corners, modelGrid, plantResponse, residues, splitDelay, addMode } from "./model.js";
import { makeObserver, observerResponse } from "./observer.js";
import { controllerSections, delayResponse, holdResponse, integrators, sectionsResponse, timing, tustinAxis } from "./response.js";

export const SIX_DB = 10 ** (6 / 20);
export const ALLOWED_DB = 6.01;
// The controller runs on the error, as that of `design`: S_O is also r to e.
export const FUNCTIONS = ["input_sensitivity", "output_sensitivity"];
export const SHOWN = { input_sensitivity: "S_I", output_sensitivity: "S_O, r to e" };
const TURN = 2 * Math.PI;

// --- what a controller meets: a plant and an observer on a grid ---

// A view of the loop: {omega, axis, plant, observer}, everything but the controller.
function view(omega, sampleTime, plant, observer) {
  return {
    omega,
    sampleTime,
    axis: tustinAxis(omega, sampleTime),
    plant,
    observer: observer ? observerResponse(observer, omega) : null,
  };
}

// Everything of a machine that stays while a block is dragged. Made anew when rate, delay or observer change.
export function makeLoop(machine, design, { points = 500, around = 24 } = {}) {
  const { sampleTime, delay, observer: block } = timing(design);
  const whole = delay + Math.max(machine.delay_s || 0, 0);
  const model = machine.model;
  let observer = null;
  if (block && (block.compensate || block.damping > 0)) {
    if (!model) throw new Error("an observer needs a fitted model: open this machine by `python -m stillwork desk FILE`");
    if (!sampleTime) throw new Error("an observer runs sampled: add a sampling block");
    observer = makeObserver(model, machine.mass, block, sampleTime, whole);
  }
  const highest = sampleTime ? (0.998 * Math.PI) / sampleTime : Infinity;
  const loop = { machine, design, sampleTime, delay: whole, observer, model: null, measured: null };
  const measured = machine.measured;
  let low = Infinity, high = 0;
  if (model) {
    const resonances = model.omega.filter((w) => w > 0);
    low = Math.min(low, (model.omega[0] || resonances[0]) / 300);
    high = Math.max(high, resonances[resonances.length - 1] * 4);
  }
  if (measured) {
    low = Math.min(low, TURN * measured.hz[0]);
    high = Math.max(high, TURN * measured.hz[measured.hz.length - 1]);
  }
  high = sampleTime ? highest : high;
  if (model) {
    const omega = modelGrid(model, low, high, points, around);
    loop.model = view(omega, sampleTime, plantResponse(model, omega, sampleTime, whole), observer);
  }
  if (measured) {
    const [first, last] = machine.band_hz.map((f) => TURN * f);
    const inside = measured.hz.map((f, k) => k).filter((k) => {
      const w = TURN * measured.hz[k];
      return w >= first && w <= last && w <= highest;
    });
    const seen = Float64Array.from(inside, (k) => TURN * measured.hz[k]);
    const position = complexArray(seen.length);
    inside.forEach((k, j) => {
      position.re[j] = -measured.re[k] / seen[j] ** 2;
      position.im[j] = -measured.im[k] / seen[j] ** 2;
    });
    const lowest = { re: position.re[0], im: position.im[0] };
    loop.measured = view(...onMeasurement(loop, machine, seen, position), observer);
    loop.measured.seen = seen.length;
    if (!model) loop.measured.below = belowLines(loop, machine.rigid, seen[0], lowest);
  }
  if (!loop.model && !loop.measured) throw new Error("the machine has neither a model nor a measurement");
  loop.places = model ? corners(model) : gainCorners(machine);
  loop.corners = loop.places.map((place) => cornerView(loop, place));
  loop.box = null;
  return loop;
}

// The measured plant inside its band, and the model below it; what sampling folds back is the model's.
function onMeasurement(loop, machine, seen, position) {
  const { sampleTime, delay } = loop, model = machine.model;
  let below = new Float64Array(0), under = complexArray(0);
  if (sampleTime) {
    const hold = holdResponse(seen, sampleTime, delay);
    let aliases = null;
    if (model) {
      const all = plantResponse(model, seen, sampleTime, delay);
      const bare = plantResponse(model, seen, 0, 0);
      aliases = complexArray(seen.length);
      for (let k = 0; k < seen.length; k++) {
        // bare times the hold is what the sampled model shows before aliasing
        const re = bare.re[k] * hold.re[k] - bare.im[k] * hold.im[k];
        const im = bare.re[k] * hold.im[k] + bare.im[k] * hold.re[k];
        aliases.re[k] = all.re[k] - re;
        aliases.im[k] = all.im[k] - im;
      }
    }
    multiplyInto(position, hold);
    if (aliases) {
      for (let k = 0; k < seen.length; k++) {
        position.re[k] += aliases.re[k];
        position.im[k] += aliases.im[k];
      }
    }
  } else multiplyInto(position, delayResponse(seen, delay));
  if (model && loop.model) {
    const count = loop.model.omega.findIndex((w) => w >= seen[0]);
    below = loop.model.omega.slice(0, Math.max(count, 0));
    under = { re: loop.model.plant.re.slice(0, below.length), im: loop.model.plant.im.slice(0, below.length) };
  }
  const join = (a, b) => {
    const all = new Float64Array(a.length + b.length);
    all.set(a);
    all.set(b, a.length);
    return all;
  };
  return [
    join(below, seen),
    sampleTime,
    { re: join(under.re, position.re), im: join(under.im, position.im) },
  ];
}

const DECADES_BELOW = 7;

// What a machine without a model is taken for below its first line: as a rigid body, with friction or on a suspension.
function belowLines({ sampleTime, delay }, rigid, first, { re, im }) {
  const omega = geomspace(first / 10 ** DECADES_BELOW, first, 24 * DECADES_BELOW), size = omega.map((w) => (first / w) ** rigid);
  const plant = { re: size.map((x) => re * x), im: size.map((x) => im * x) };
  multiplyInto(plant, sampleTime ? holdResponse(omega, sampleTime, delay) : delayResponse(omega, delay));
  return view(omega, sampleTime, plant, null);
}

// Without a model the box holds the gain and the delay alone.
function gainCorners(machine) {
  const box = machine.uncertainty;
  if (!box || !(box.gain || box.delay)) return [];
  return [-1, 1].map((sign) => ({ gain: 1 + sign * (box.gain || 0), delay: sign * (box.delay || 0) }));
}

function cornerView(loop, place) {
  const base = loop.model ?? loop.measured;
  if (!loop.model) return { ...movedView(base, place), below: movedView(base.below, place) };
  return { ...base, plant: plantResponse(loop.machine.model, base.omega, loop.sampleTime, loop.delay, place) };
}

function movedView(base, place) {
  const plant = delayResponse(base.omega, place.delay);
  multiplyInto(plant, base.plant);
  multiplyInto(plant, complexArray(base.omega.length, place.gain));
  return { ...base, plant };
}

// One more place of the box, found to do harm, that is looked at from now on.
export function addPlace(loop, place) {
  loop.places.push(place);
  loop.corners.push(cornerView(loop, place));
}

// --- the functions of a loop ---

export const controllerOn = (sections, seen) => sectionsResponse(sections, seen.axis);

// Sizes of the functions on a view: arrays by name; `whole`: the open loops and the others, too. Without an observer both
// sensitivities are one.
export function loopFunctions(seen, controller, whole = false) {
  const n = seen.omega.length, P = seen.plant, C = controller, O = seen.observer;
  const first = new Float64Array(n);
  const found = {
    input_sensitivity: first,
    output_sensitivity: O ? new Float64Array(n) : first,
  };
  if (whole) {
    found.loop = complexArray(n);
    found.output_loop = O ? complexArray(n) : found.loop;
    found.closed = new Float64Array(n);
    found.process = new Float64Array(n);
  }
  const start = {};
  let crossed = 0, br = 0, bi = 0; // of the negative real axis, upwards less downwards
  for (let k = 0; k < n; k++) {
    const p = P.re[k], q = P.im[k], c = C.re[k], d = C.im[k];
    const pcr = p * c - q * d, pci = p * d + q * c;
    let tr = 1, ti = 0, vr = pcr, vi = pci, dr = 1 + pcr, di = pci;
    if (O) {
      // turn = 1 - C o_yu - o_uu, slope = C (1 - o_yy) - o_uy, above = 1 - o_uu - o_uy P
      const yur = O.yu.re[k], yui = O.yu.im[k], yyr = O.yy.re[k], yyi = O.yy.im[k], uyr = O.uy.re[k], uyi = O.uy.im[k];
      tr = 1 - (c * yur - d * yui) - O.uu.re[k];
      ti = -(c * yui + d * yur) - O.uu.im[k];
      const sr = c - (c * yyr - d * yyi) - uyr, si = d - (c * yyi + d * yyr) - uyi;
      const ar = 1 - O.uu.re[k] - (uyr * p - uyi * q), ai = -O.uu.im[k] - (uyr * q + uyi * p);
      vr = p * sr - q * si;
      vi = p * si + q * sr;
      dr = tr + vr;
      di = ti + vi;
      const size = dr * dr + di * di;
      found.input_sensitivity[k] = Math.sqrt((ar * ar + ai * ai) / size);
      found.output_sensitivity[k] = Math.sqrt((tr * tr + ti * ti) / size);
      if (whole) {
        const above = ar * ar + ai * ai, turn = tr * tr + ti * ti;
        found.output_loop.re[k] = (vr * tr + vi * ti) / turn;
        found.output_loop.im[k] = (vi * tr - vr * ti) / turn;
        const yr = p - (yyr * p - yyi * q) - yur, yi = q - (yyr * q + yyi * p) - yui;
        const nr = yr * c - yi * d, ni = yr * d + yi * c;
        found.loop.re[k] = (nr * ar + ni * ai) / above;
        found.loop.im[k] = (ni * ar - nr * ai) / above;
      }
    } else {
      first[k] = 1 / Math.sqrt(dr * dr + di * di);
      if (whole) {
        found.loop.re[k] = pcr;
        found.loop.im[k] = pci;
      }
    }
    if (whole) {
      const size = Math.sqrt(dr * dr + di * di);
      found.closed[k] = Math.sqrt(vr * vr + vi * vi) / size;
      found.process[k] = Math.sqrt((p * p + q * q) * (tr * tr + ti * ti)) / size;
    }
    if (k === 0) start.angle = Math.atan2(di, dr);
    else if (bi >= 0 !== di >= 0 && (bi >= 0 ? br * di - bi * dr > 0 : br * di - bi * dr < 0)) crossed += bi >= 0 ? 1 : -1;
    br = dr;
    bi = di;
  }
  found.phase = { start: start.angle, turns: Math.atan2(bi, br) - start.angle + TURN * crossed };
  return found;
}

// Closed-loop poles outside the stable region, by the argument of turn + P slope along the upper half of the boundary;
// `open` poles of the open loop lie at the origin, all others are stable. The path begins and ends at a multiple of a
// quarter turn.
export function unstablePoles(phase, open) {
  const quarter = Math.PI / 2;
  const end = phase.start + phase.turns;
  const begin = quarter * nearestParity(phase.start / quarter, open);
  const last = Math.PI * Math.round(end / Math.PI);
  return Math.round(open / 2 - (last - begin) / Math.PI);
}

// The argument from far below the first line on: what is assumed there comes first.
function wholePhase(seen, sections, { phase }) {
  if (!seen.below) return phase;
  const under = loopFunctions(seen.below, controllerOn(sections, seen.below)).phase;
  return { start: under.start, turns: under.turns + phase.turns };
}

function nearestParity(value, like) {
  let whole = Math.round(value);
  if ((whole - like) % 2 !== 0) whole += value > whole ? 1 : -1;
  return whole;
}

export function openPoles(machine, design) {
  const model = machine.model;
  const rigid = !model ? machine.rigid : model.omega[0] > 0 ? 0 : model.drag > 0 ? 1 : 2;
  return rigid + integrators(design);
}

function largest(values, omega) {
  let at = 0;
  for (let k = 1; k < values.length; k++) if (values[k] > values[at]) at = k;
  return { size: values[at], hz: omega[at] / TURN };
}

// First frequency at which the open loop falls through 0 dB, Hz; NaN when it does not.
export function crossingHz(omega, loop) {
  const sizeAt = (k) => Math.sqrt(loop.re[k] * loop.re[k] + loop.im[k] * loop.im[k]);
  let before = sizeAt(0);
  for (let k = 1; k < omega.length; k++) {
    const size = sizeAt(k);
    if (before >= 1 && size < 1) {
      const share = Math.log(before) / Math.log(before / size);
      return (omega[k - 1] * (omega[k] / omega[k - 1]) ** share) / TURN;
    }
    before = size;
  }
  return NaN;
}

// Least phase margin over all crossings of 0 dB (degrees), least gain margins up and down (dB), modulus margin.
export function margins(loop) {
  let phase = Infinity, up = Infinity, down = Infinity, modulus = Infinity;
  const { re, im } = loop;
  let a = 0;
  for (let k = 0; k < re.length; k++) {
    modulus = Math.min(modulus, (1 + re[k]) ** 2 + im[k] ** 2);
    const b = Math.sqrt(re[k] * re[k] + im[k] * im[k]);
    if (k && a >= 1 !== b >= 1) {
      const share = Math.log(a) / Math.log(a / b);
      const x = re[k - 1] + share * (re[k] - re[k - 1]), y = im[k - 1] + share * (im[k] - im[k - 1]);
      phase = Math.min(phase, Math.abs((Math.atan2(-y, -x) * 180) / Math.PI));
    }
    a = b;
    if (k && im[k - 1] >= 0 !== im[k] >= 0) {
      const share = im[k - 1] / (im[k - 1] - im[k]), x = re[k - 1] + share * (re[k] - re[k - 1]);
      if (x < 0 && x > -1) up = Math.min(up, -toDb(-x));
      else if (x <= -1) down = Math.min(down, toDb(-x));
    }
  }
  return { phase, up, down, modulus: Math.sqrt(modulus) };
}

// Everything that is shown of a design: the functions, what they reach, and whether it holds.
export function judge(loop, design, { whole = true, places = true } = {}) {
  const sections = controllerSections(design, loop.sampleTime), open = openPoles(loop.machine, design);
  const result = { sections };
  const shown = loop.measured ?? loop.model;
  for (const name of ["model", "measured"]) {
    const seen = loop[name];
    if (!seen) continue;
    result[name] = loopFunctions(seen, controllerOn(sections, seen), whole || seen === shown);
  }
  const base = result.model ?? result.measured;
  result.unstable = unstablePoles(wholePhase(loop.model ?? loop.measured, sections, base), open);
  if (result.model && result.measured) result.extraTurns = extraTurns(loop, sections, result.measured);
  const main = loop.measured ? result.measured : result.model;
  result.main = main;
  result.omega = shown.omega;
  result.bandwidth = crossingHz(shown.omega, main.loop);
  result.margins = margins(main.output_loop);
  result.nominal = {};
  for (const name of FUNCTIONS) {
    const peaks = ["model", "measured"].filter((each) => result[each]).map((each) => ({
      ...largest(result[each][name], loop[each].omega),
      where: each,
    }));
    result.nominal[name] = peaks.reduce((a, b) => (b.size > a.size ? b : a));
  }
  result.box = null;
  if (places && loop.corners.length) {
    const band = {};
    const names = loop.observer ? FUNCTIONS : FUNCTIONS.slice(0, 1);
    for (const name of FUNCTIONS) band[name] = names.includes(name) ? Float64Array.from(base[name]) : band[names[0]];
    result.box = { exact: false, band, unstable: 0 };
    const c = controllerOn(sections, loop.corners[0]);
    for (const corner of loop.corners) {
      const found = loopFunctions(corner, c);
      // A box whose middle is stable and whose sensitivity is bounded is stable: its corners are counted all the same.
      result.box.unstable = Math.max(result.box.unstable, unstablePoles(wholePhase(corner, sections, found), open));
      for (const name of names) {
        const most = band[name], own = found[name];
        for (let k = 0; k < most.length; k++) if (own[k] > most[k]) most[k] = own[k];
      }
    }
    for (const name of FUNCTIONS) result.box[name] = largest(band[name], loop.corners[0].omega);
  }
  result.stable = result.unstable === 0 && !result.extraTurns && !(result.box && result.box.unstable);
  return result;
}

// Turns around -1 that the measured loop makes more than the model's, on the measured band.
function extraTurns(loop, sections, measured) {
  const seen = loop.measured;
  if (!loop.modelOnLines) {
    const plant = plantResponse(loop.machine.model, seen.omega, loop.sampleTime, loop.delay);
    loop.modelOnLines = { ...seen, plant };
  }
  const model = loopFunctions(loop.modelOnLines, controllerOn(sections, seen));
  const difference = (name) => measured.phase[name] - model.phase[name];
  let start = difference("start");
  start -= TURN * Math.round(start / TURN);
  // Both paths seen as ratios step by step: what is left beside the ends is whole turns.
  return Math.round(difference("turns") / TURN);
}

// --- the whole box ---

const STEPS = Array.from({ length: 25 }, (_, k) => -1 + k / 12);

// What the plant may be at each frequency of a grid: each mode at places of its frequency and damping, by rows; and how
// far the whole plant can be from its middle.
export function makeBox(loop, omega) {
  const model = loop.machine.model, spread = model.uncertainty, time = loop.sampleTime, rows = omega.length;
  const [whole, late] = splitDelay(time ? loop.delay / time : 0);
  const gains = residues(model);
  const turn = time ? delayResponse(omega, whole * time) : delayResponse(omega, loop.delay);
  const drags = dragsOf(model.drag ?? 0, spread.friction ?? 0);
  const parts = model.omega.map((w, k) => {
    const z = model.damping[k], share = spread.frequency[k];
    const factors = spread.damping[k] > 1e-3 ? [1, 1 - spread.damping[k], 1 + spread.damping[k]] : [1];
    // A rigid body's places are those of its friction.
    const tried = share ? placesOf(omega, w, z, share, time) : (w ? [w] : drags).map(() => Float64Array.from(omega, () => w));
    const columns = factors.length * tried.length;
    const part = { columns, nominal: tried.length > 1 ? 2 : 0, re: new Float64Array(rows * columns), im: new Float64Array(rows * columns), tried, factors };
    factors.forEach((factor, i) => {
      const ratio = Math.min(z * factor, 0.999);
      tried.forEach((frequencies, j) => {
        const column = i * tried.length + j, one = complexArray(rows);
        if (j < 3 || !w) addMode(one, gains[k], frequencies[0], ratio, omega, time, late, drags[j]);
        else movingMode(one, gains[k], frequencies, ratio, omega, time, late);
        multiplyInto(one, turn);
        for (let f = 0; f < rows; f++) {
          part.re[f * columns + column] = one.re[f];
          part.im[f * columns + column] = one.im[f];
        }
      });
    });
    return part;
  });
  const fixed = complexArray(rows, model.feedthrough);
  multiplyInto(fixed, turn);
  if (time) multiplyInto(fixed, delayResponse(omega, time));
  const delays = spread.delay && time ? [0, -1, -0.5, 0.5, 1].map((x) => Math.max(x * spread.delay, -loop.delay)) : [0];
  const box = {
    omega,
    axis: tustinAxis(omega, time),
    parts,
    fixed,
    low: spread.residue.map((x, k) => (k ? 1 - x : 1 / (1 + spread.mass))),
    high: spread.residue.map((x, k) => (k ? 1 + x : 1 / (1 - spread.mass))),
    gain: spread.gain,
    delays,
    late: delays.map((seconds) => delayResponse(omega, seconds)),
    observer: loop.observer ? observerResponse(loop.observer, omega) : null,
    frequencies: model.omega,
    frictions: drags.map((drag) => drag - (model.drag ?? 0)),
    middle: { re: Float64Array.from(fixed.re), im: Float64Array.from(fixed.im) },
    radius: new Float64Array(rows),
  };
  for (let row = 0; row < rows; row++) {
    let radius = 0;
    parts.forEach(({ columns, nominal, re, im }, k) => {
      const at = row * columns, x = re[at + nominal], y = im[at + nominal];
      let far = 0, size = 0;
      for (let j = at; j < at + columns; j++) {
        far = Math.max(far, (re[j] - x) ** 2 + (im[j] - y) ** 2);
        size = Math.max(size, re[j] ** 2 + im[j] ** 2);
      }
      radius += Math.sqrt(far) + Math.max(box.high[k] - 1, 1 - box.low[k]) * Math.sqrt(size);
      box.middle.re[row] += x;
      box.middle.im[row] += y;
    });
    let turned = 0;
    for (const each of box.late) turned = Math.max(turned, Math.hypot(each.re[row] - 1, each.im[row]));
    box.radius[row] = radius + (box.gain + turned * (1 + box.gain)) * (Math.hypot(box.middle.re[row], box.middle.im[row]) + radius);
  }
  return box;
}

// Frictions (1/s) that are tried: the lowest, the highest, that of the model, and between.
function dragsOf(drag, spread) {
  if (!spread) return [drag];
  const low = Math.max(drag - spread, 0), high = drag + spread, between = 18;
  return [low, high, drag, ...Array.from({ length: between - 1 }, (_, k) => low + ((k + 1) * (high - low)) / between)];
}

// A mode whose frequency is another at each line.
function movingMode(sum, gain, frequencies, ratio, omega, time, late) {
  const one = complexArray(1), at = new Float64Array(1);
  for (let f = 0; f < omega.length; f++) {
    one.re[0] = one.im[0] = 0;
    at[0] = omega[f];
    addMode(one, gain, frequencies[f], ratio, at, time, late);
    sum.re[f] = one.re[0];
    sum.im[f] = one.im[0];
  }
}

// Frequencies of a mode that are tried at each frequency: lowest, highest, found, and beside the line.
function placesOf(omega, w, z, share, time) {
  const low = w * (1 - share), high = w * (1 + share), n = omega.length;
  const folded = time ? (TURN * Math.round((w * time) / TURN)) / time : 0;
  const sign = w < folded ? -1 : 1, width = Math.max(z, 1e-7), reach = Math.asinh((2 * share) / width);
  const rows = [low, high, w].map((value) => new Float64Array(n).fill(value));
  for (const step of STEPS) {
    const factor = 1 + width * Math.sinh(reach * step);
    rows.push(Float64Array.from(omega, (v) => Math.min(Math.max(Math.abs(folded + sign * v) * factor, low), high)));
  }
  return rows;
}

export function boxGrid(loop, points = 300, around = 24) {
  const model = loop.machine.model, time = loop.sampleTime, rate = time ? TURN / time : Infinity;
  const low = loop.model.omega[0], high = loop.model.omega[loop.model.omega.length - 1];
  const fold = (w) => (time ? Math.abs(w - rate * Math.round(w / rate)) : w);
  const poles = [], between = [];
  model.omega.forEach((w, k) => {
    if (!w) return;
    const share = model.uncertainty.frequency[k];
    for (const factor of [1 - share, 1, 1 + share]) poles.push({ omega: fold(w * factor), width: w * model.damping[k] });
    for (let j = -30; share && j <= 30; j++) between.push(fold(w * (1 + (1.02 * share * j) / 30)));
  });
  const grid = resonanceGrid(poles.filter((each) => each.omega > 0), low, high, points, around);
  return sortedUnique([...grid, ...between.filter((w) => w > low && w < high)]);
}

// Where |1 + (a + x b) / (c + x d)| is largest from low to high: at an end, or where its slope, a quadratic, is zero. The
// quadratic is that of the difference of both squares: their own would cancel where a and b are small.
function along(ar, ai, br, bi, cr, ci, dr, di, low, high) {
  const c0 = cr * cr + ci * ci, c1 = cr * dr + ci * di, c2 = dr * dr + di * di;
  const e0 = 2 * (cr * ar + ci * ai) + ar * ar + ai * ai;
  const e1 = cr * br + ci * bi + ar * (dr + br) + ai * (di + bi);
  const e2 = 2 * (dr * br + di * bi) + br * br + bi * bi;
  const p = e2 * c1 - e1 * c2, q = e2 * c0 - e0 * c2, r = e1 * c0 - e0 * c1;
  const tried = [low, high], root = q * q - 4 * p * r;
  if (root > 0) {
    const half = -0.5 * (q + Math.sign(q || 1) * Math.sqrt(root));
    for (const x of [p !== 0 ? half / p : low, half !== 0 ? r / half : low]) tried.push(Math.min(Math.max(x, low), high));
  }
  let best = low, most = -1;
  for (const x of tried) {
    const ur = cr + x * dr, ui = ci + x * di, or = ur + (ar + x * br), oi = ui + (ai + x * bi);
    const size = (or * or + oi * oi) / (ur * ur + ui * ui);
    if (size > most) [most, best] = [size, x];
  }
  return best;
}

// The search of the box: call `step(milliseconds)` until it returns true; `results()` then holds by function the
// largest size above `least`, where, and the place. Three starts at each frequency and a scattered one, two sweeps over
// the numbers each; a frequency is passed over where even the triangle inequality keeps it below what was found.
export function boxSearch(loop, sections, { box = (loop.box ??= makeBox(loop, boxGrid(loop))), starts = 4, least = 0 } = {}) {
  const C = sectionsResponse(sections, box.axis), O = box.observer, modes = box.parts.length;
  const names = O ? FUNCTIONS : FUNCTIONS.slice(0, 1);
  const found = Object.fromEntries(FUNCTIONS.map((name) => [name, { square: least * least, row: -1 }]));
  const taken = new Int32Array(modes), factors = new Float64Array(modes);
  let row = 0;
  const searchRow = () => {
    const c = C.re[row], d = C.im[row], mr = box.middle.re[row], mi = box.middle.im[row];
    // turn + P slope below, and what S_I has beside it above.
    let tr = 1, ti = 0, sr = c, si = d, ur = 0, ui = 0, vr = -c, vi = -d;
    if (O) {
      const yur = O.yu.re[row], yui = O.yu.im[row], yyr = O.yy.re[row] - 1, yyi = O.yy.im[row];
      ur = c * yur - d * yui;
      ui = c * yui + d * yur;
      vr = c * yyr - d * yyi;
      vi = c * yyi + d * yyr;
      tr = 1 - O.uu.re[row] - ur;
      ti = -O.uu.im[row] - ui;
      sr = -vr - O.uy.re[row];
      si = -vi - O.uy.im[row];
    }
    const slope = Math.sqrt(sr * sr + si * si);
    const below = Math.sqrt((tr + sr * mr - si * mi) ** 2 + (ti + sr * mi + si * mr) ** 2) - slope * box.radius[row];
    for (const name of names) {
      const best = found[name];
      const [ar, ai, br, bi] = name === "input_sensitivity" ? [ur, ui, vr, vi] : [0, 0, -sr, -si];
      if (below > 0) {
        const nr = tr + ar, ni = ti + ai, gr = sr + br, gi = si + bi;
        const middle = Math.sqrt((nr + gr * mr - gi * mi) ** 2 + (ni + gr * mi + gi * mr) ** 2);
        const top = middle + Math.sqrt(gr * gr + gi * gi) * box.radius[row];
        if (top * top <= best.square * below * below) continue;
      }
      const value = (p, q) => {
        const u = tr + sr * p - si * q, v = ti + sr * q + si * p, x = u + (ar + br * p - bi * q), y = v + (ai + br * q + bi * p);
        return (x * x + y * y) / (u * u + v * v);
      };
      for (let start = 0; start < starts; start++) {
        let gain = 1, when = 0, wr = box.fixed.re[row], wi = box.fixed.im[row];
        for (let k = 0; k < modes; k++) {
          const { columns, re, im } = box.parts[k];
          taken[k] = start < 3 ? (start < columns ? start : 0) : ((row + 1) * 7919 * (k + 1) + start * 104729) % columns;
          factors[k] = 1;
          wr += re[row * columns + taken[k]];
          wi += im[row * columns + taken[k]];
        }
        for (let sweep = 0; sweep < 2; sweep++) {
          for (let k = 0; k < modes; k++) {
            const { columns, re, im } = box.parts[k], at = row * columns, factor = factors[k];
            const or = wr - factor * re[at + taken[k]], oi = wi - factor * im[at + taken[k]];
            const lr = gain * box.late[when].re[row], li = gain * box.late[when].im[row];
            if (columns > 1) {
              let most = -1;
              for (let j = 0; j < columns; j++) {
                const x = or + factor * re[at + j], y = oi + factor * im[at + j];
                const size = value(lr * x - li * y, lr * y + li * x);
                if (size > most) {
                  most = size;
                  taken[k] = j;
                }
              }
            }
            const xr = re[at + taken[k]], xi = im[at + taken[k]];
            if (box.high[k] > box.low[k]) {
              const er = lr * or - li * oi, ei = lr * oi + li * or, fr = lr * xr - li * xi, fi = lr * xi + li * xr;
              factors[k] = along(
                ar + br * er - bi * ei, ai + br * ei + bi * er, br * fr - bi * fi, br * fi + bi * fr,
                tr + sr * er - si * ei, ti + sr * ei + si * er, sr * fr - si * fi, sr * fi + si * fr,
                box.low[k], box.high[k],
              );
            }
            wr = or + factors[k] * xr;
            wi = oi + factors[k] * xi;
          }
          let most = -1;
          for (let j = 0; j < box.late.length; j++) {
            const lr = gain * box.late[j].re[row], li = gain * box.late[j].im[row];
            const size = value(lr * wr - li * wi, lr * wi + li * wr);
            if (size > most) {
              most = size;
              when = j;
            }
          }
          if (box.gain) {
            const lr = box.late[when].re[row], li = box.late[when].im[row], pr = lr * wr - li * wi, pi = lr * wi + li * wr;
            gain = along(
              ar, ai, br * pr - bi * pi, br * pi + bi * pr, tr, ti, sr * pr - si * pi, sr * pi + si * pr,
              1 - box.gain, 1 + box.gain,
            );
          }
        }
        const lr = gain * box.late[when].re[row], li = gain * box.late[when].im[row];
        const size = value(lr * wr - li * wi, lr * wi + li * wr);
        if (size > best.square) found[name] = { square: size, row, taken: [...taken], factors: [...factors], gain, when };
        if (size > best.square) best.square = size;
      }
    }
  };
  const step = (milliseconds = Infinity) => {
    const until = performance.now() + milliseconds;
    while (row < box.omega.length) {
      searchRow();
      row++;
      if (row % 8 === 0 && performance.now() > until) return row >= box.omega.length;
    }
    return true;
  };
  const resultOf = (best) => {
    if (best.row < 0) return { size: least, hz: 0, place: null };
    const which = (k) => {
      const { tried } = box.parts[k];
      return [tried[best.taken[k] % tried.length], Math.floor(best.taken[k] / tried.length)];
    };
    const place = {
      frequencies: box.frequencies.map((w, k) => (w > 0 ? which(k)[0][best.row] / w : 1)),
      residues: best.factors,
      damping: box.frequencies.map((_, k) => box.parts[k].factors[which(k)[1]]),
      gain: best.gain,
      delay: box.delays[best.when],
      friction: box.frequencies[0] ? 0 : box.frictions[best.taken[0]],
    };
    return { size: Math.sqrt(best.square), hz: box.omega[best.row] / TURN, place };
  };
  const results = () =>
    Object.fromEntries(FUNCTIONS.map((name) => [name, resultOf(found[names.includes(name) ? name : names[0]])]));
  return { step, results, progress: () => row / box.omega.length };
}
