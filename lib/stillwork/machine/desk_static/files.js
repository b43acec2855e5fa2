// Files that are dropped: a frequency response as CSV, or the controller.json of a design.

import { DRIVES, MOVES, POSITIONS, columnUnit, heading, isBareAbscissa, meaning, unitFactor } from "./headings.js";

const SILENT = ["frequency", "time", "rate", "phase", "coherence"]; // their units are none of a machine's
const EMPTY = ["", "#N/A", "#NA", "N/A", "n/a", "NA", "NaN", "nan", "-nan", "null", "NULL", "None"]; // fields without a number
export const RESPONSE_UNITS = Object.keys(MOVES);
export const DRIVE_UNITS = DRIVES;

// Units of response and drive that the names state: {response, drive}, empty where none does.
export function statedUnits(names) {
  const found = { response: "", drive: "" };
  const state = (kind, unit) => {
    const [one, other] = [found[kind] || unit, unit].map(unitFactor);
    if (one[0] !== other[0] || one[1] !== other[1]) throw new Error(`the ${kind} is in ${found[kind]} and in ${unit}, and columns of mixed units are not taken; give those of one unit in a file of their own`);
    found[kind] ||= unit;
  };
  for (const { quantity, means } of names.map(heading)) {
    if (!means || means.power || SILENT.includes(quantity)) continue;
    if (means.si in MOVES && DRIVES.includes(means.lowerSi)) {
      state("response", means.upper);
      state("drive", means.lower);
    } else if (!means.lower && means.si in MOVES && quantity !== "force") state("response", means.upper);
    else if (!means.lower && DRIVES.includes(means.si)) state("drive", means.upper);
  }
  return found;
}

const numeric = (each) => !EMPTY.includes(each) && Number.isFinite(Number(each.replace(",", ".")));

// Fields of a line but empty ones at its end; a mark in quotation marks is none, nor in brackets where there are `width` names.
function fieldsOf(line, mark, width = 0) {
  const parts = mark ? [""] : line.trim().split(/\s+/);
  let quoted = false;
  for (const letter of mark ? line : "") {
    if (letter === '"') quoted = !quoted;
    if (letter === mark && !quoted) parts.push("");
    else parts[parts.length - 1] += letter;
  }
  if (width && parts.length > width && !line.includes('"')) {
    const bracketed = mark ? null : line.match(/[^\s([{]+(?:\s*[([{][^)\]}]*[)\]}]+)?/g);
    const outside = mark ? line.split(new RegExp(`[${mark}](?![^([{]*[)\\]}])`)) : bracketed ?? [];
    if (outside.length === width) parts.splice(0, parts.length, ...outside);
  }
  const all = parts.map((each) => each.trim().replace(/^"(.*)"$/, "$1").trim());
  return all.slice(0, all.findLastIndex(Boolean) + 1);
}

// The mark between the fields, and the first line that holds numbers alone, as the next one does; or the second line.
function firstRow(lines, given) {
  const marks = given ? [given] : ["\t", ";", ",", ""];
  const isRow = (line, mark) => {
    const fields = fieldsOf(line, mark);
    return fields.some(numeric) && fields.every((each) => numeric(each) || EMPTY.includes(each));
  };
  for (let k = 0; k < Math.min(lines.length, 1000); k++) {
    for (const mark of marks) if (lines[k].includes(mark) && lines.slice(k, k + 2).every((line) => isRow(line, mark))) return [mark, k];
  }
  return [given ?? marks.find((each) => each && lines[1].includes(each)) ?? "", 1];
}

// The names above the first row of numbers, with units that stand in a row below them, and where the rows begin.
function namesAbove(lines, mark, first) {
  const width = fieldsOf(lines[first], mark).length;
  const above = lines.slice(0, first).map((line) => fieldsOf(line, mark, width));
  const units = above[first - 1].map((each) => each.replace(/^[()[\] ]+|[()[\] ]+$/g, "")), upper = above[first - 2];
  const known = units.filter((each) => meaning(each) && !numeric(each)).length;
  if (upper && 2 * known >= Math.max(units.filter(Boolean).length, 1) && upper.length >= units.length) {
    return [upper.map((name, k) => (units[k] ? `${name} (${units[k]})` : name)), first];
  }
  let at = first - 1;
  while (at && above[at - 1].length === above[at].length && above[at].some(numeric)) at--;
  return [above[at], at + 1];
}

// The names in comments right above rows without any, as numpy.savetxt writes them.
function commented(comments, mark, width) {
  for (const each of comments.length ? [mark, ",", ";", "\t", ""] : []) {
    const row = Array(width).fill("0").join(each || " "), [names] = namesAbove([...comments, row], each, comments.length);
    const stated = names.filter((name) => !numeric(name)).map(heading);
    if (stated.length === width && names.length === width && stated.some(({ quantity, means }) => quantity || means)) return names;
  }
  throw new Error("its first line is no line of names; name the columns, e.g. frequency (Hz),real,imaginary");
}

// Columns of a table of numbers by name; lines that begin with # are skipped, and notes above the names.
export function parseTable(text) {
  const written = text.replace(/^\uFEFF/, "").split(/\r?\n/).map((line) => line.replace(/^ +| +$/g, "")).filter((line) => line.trim());
  const isComment = (line) => line.startsWith("#") && !line.startsWith("#N/A"), lines = written.filter((line) => !isComment(line));
  const comments = written.slice(0, written.indexOf(lines[0])).map((line) => line.replace(/^[# ]+/, ""));
  const given = lines[0]?.match(/^"?sep=(.)"?$/)?.[1];
  if (given) lines.shift();
  if (lines.length < 2) throw new Error("it holds no table: give a line of names and rows of numbers");
  const [mark, first] = firstRow(lines, given);
  const [names, below] = first ? namesAbove(lines, mark, first) : [commented(comments, mark, fieldsOf(lines[0], mark).length), 0];
  const rows = lines.slice(below).map((line) => fieldsOf(line, mark));
  const again = names.find((name, k) => names.indexOf(name) < k);
  if (again !== undefined) throw new Error(`it names two columns ${again}; give each a name of its own`);
  const comma = rows.some((row) => row.some((each) => each.includes(","))) && !rows.some((row) => row.some((each) => each.includes(".")));
  const numbers = rows.map((all, k) => {
    if (all.length > names.length) throw new Error(`row ${k + 1} holds ${all.length} values for ${names.length} columns`);
    return names.map((name, j) => {
      const each = all[j] ?? "", value = EMPTY.includes(each) ? NaN : Number(comma ? each.replace(",", ".") : each);
      if (Number.isNaN(value) && !EMPTY.includes(each)) throw new Error(`${name}: ${each} in row ${k + 1} is not a number; correct it`);
      return value;
    });
  });
  return Object.fromEntries(names.map((name, k) => [name, numbers.map((row) => row[k])]));
}

// The complex response of real and imaginary, or of magnitude and phase, and what was taken without a word in the file.
function responseOf(columns, names) {
  const called = (quantity) => names.filter((name) => heading(name).quantity === quantity);
  const pairs = [["real", "imaginary"], ["magnitude", "phase"]].map((pair) => pair.map((each) => [each, called(each)]));
  const whole = pairs.find((pair) => pair.every(([, found]) => found.length === 1));
  const several = pairs.filter((pair) => pair.every(([, found]) => found.length)).flatMap((pair) => pair.flatMap(([, found]) => found));
  if (!whole && several.length) throw new Error(`it holds several responses (${several.join(", ")}); leave some out`);
  if (!whole) throw new Error("no response stands beside the frequency; give real and imaginary, or magnitude and phase");
  const [[first, [one]], [second, [other]]] = whole;
  const x = columnUnit(one, first), y = columnUnit(other, second), plain = (unit) => (unit.si === "1" ? unit.factor : 1);
  if (x.lowerSi ? !(MOVES[x.si] && DRIVES.includes(x.lowerSi)) : !(MOVES[x.si] || x.si === "1")) throw new Error(`${one}: a response is a motion over a force`);
  if (first === "real") return { values: columns[one].map((value, k) => [plain(x) * value, plain(y) * columns[other][k]]), silent: [] };
  const values = columns[one].map((value, k) => {
    const size = plain(x) * (x.decibels ? x.reference * 10 ** (value / 20) : value), angle = y.factor * columns[other][k];
    return [size * Math.cos(angle), size * Math.sin(angle)];
  });
  return { values, silent: [...(y.written ? [] : ["phase in degrees"]), ...(heading(one).unit ? [] : ["magnitude linear"])] };
}

// A machine out of a CSV file; `units` {response, drive} where the file does not say them.
export function machineOfTable(text, name, units = {}) {
  const columns = parseTable(text), names = Object.keys(columns), quantities = names.map((each) => heading(each).quantity);
  const holds = (...each) => each.every((quantity) => quantities.includes(quantity));
  const bare = (holds("real", "imaginary") || holds("magnitude", "phase")) && !holds("time") && !holds("rate");
  const axis = names[quantities.indexOf("frequency")] ?? (bare ? names.find(isBareAbscissa) : undefined);
  if (axis === undefined) {
    const first = names.map((each) => each.toLowerCase().split(/[\s([_\d]/)[0]), has = (...words) => words.every((word) => first.includes(word));
    throw new Error(
      quantities.includes("force") || has("m", "k") || has("mass", "stiffness")
        ? "hammer records and matrices need a fit: run `python -m stillwork desk FILE`"
        : `it holds ${names.join(", ")}, and no frequency; name it so`,
    );
  }
  const bad = names.find((each) => heading(each).unknown || heading(each).strange);
  if (bad !== undefined) columnUnit(bad, heading(bad).quantity || "real");
  const hertz = (each) => {
    const unit = columnUnit(each, "frequency"), factor = unit.factor / (unit.si === "rad/s" ? 2 * Math.PI : 1);
    return columns[each].map((value) => value * factor);
  };
  const hz = hertz(axis);
  for (const other of names.filter((each, k) => quantities[k] === "frequency" && each !== axis)) {
    if (hertz(other).some((value, k) => Math.abs(value - hz[k]) > 1e-3 * hz[k])) {
      throw new Error(`${axis} and ${other} are not the same frequencies; leave one of them out`);
    }
  }
  const { values, silent } = responseOf(columns, names);
  for (let k = 1; k < hz.length; k++) {
    if (!(hz[k] > hz[k - 1])) throw new Error("the frequency does not rise from line to line; sort the rows");
  }
  const read = names.filter((each, k) => ["real", "imaginary", "magnitude"].includes(quantities[k])); // a column beside them may hold anything
  const stated = statedUnits(read), notes = [];
  if (!columnUnit(axis, "frequency").written) silent.unshift("frequency in Hz");
  if (silent.length) notes.push(`the file does not say it; taken for: ${silent.join(", ")}`);
  const response = units.response || stated.response || "m/s^2";
  const [factor, responseUnit] = unitFactor(response) ?? [];
  const order = RESPONSE_UNITS.indexOf(responseUnit);
  if (!(order >= 0)) throw new Error(`${response} is no acceleration, velocity or position`);
  const position = POSITIONS[Math.floor(order / 3)], derivatives = order % 3;
  const drive = units.drive || stated.drive || (position === "rad" ? "N m" : "N");
  const [force, driveUnit] = unitFactor(drive) ?? [];
  if (!DRIVES.includes(driveUnit)) throw new Error(`${drive} is no force, torque, current or voltage`);
  const lost = values.filter(([re, im]) => !Number.isFinite(re + im)).length;
  if (lost) notes.push(`${lost === 1 ? "a line" : `${lost} lines`} without a number left out`);
  if (!(units.response || stated.response)) notes.push(`the file does not say its units; taken for ${response} over ${drive}`);
  const measured = { hz: [], re: [], im: [] };
  hz.forEach((f, k) => {
    let [re, im] = values[k];
    if (!(f > 0) || !(Math.hypot(re, im) > 0) || !Number.isFinite(re + im)) return;
    const w = 2 * Math.PI * f;
    re *= factor / force;
    im *= factor / force;
    for (let j = 0; j < derivatives; j++) [re, im] = [-im * w, re * w];
    measured.hz.push(f);
    measured.re.push(re);
    measured.im.push(im);
  });
  const lines = measured.hz.length;
  if (lines < 32) throw new Error(`${lines} usable lines are too few; give at least 32`);
  return measuredAlone({
    name,
    units: { position, drive: driveUnit },
    notes,
    measured,
    band_hz: [measured.hz[0], measured.hz[lines - 1]],
    model: null,
    delay_s: 0,
    uncertainty: { gain: 0.05, delay: 0 },
  });
}

// How often a machine integrates its force below its first line.
export const BELOW = ["a suspension", "friction", "a rigid body"];

// A machine of which a measurement is all: what it is below the first line, and whether it is counted against its force,
// by slope and phase of its first octave, or as given; its mass, as which it moves there.
export function measuredAlone(machine, given = null) {
  const { hz, re, im } = machine.measured;
  const count = Math.min(Math.max(8, hz.filter((f) => f <= 2 * hz[0]).length), hz.length);
  const x = hz.slice(0, count).map(Math.log), sizes = x.map((_, k) => Math.hypot(re[k], im[k]));
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / count, middle = mean(x);
  const slope = mean(x.map((v, k) => (v - middle) * Math.log(sizes[k]))) / mean(x.map((v) => (v - middle) ** 2)) - 2; // of the position
  const degrees = (Math.atan2(mean(sizes.map((size, k) => -im[k] / size)), mean(sizes.map((size, k) => -re[k] / size))) * 180) / Math.PI;
  let best = { cost: Infinity };
  for (const rigid of given === null ? [2, 1, 0] : [given]) {
    for (const sign of [1, -1]) {
      const angle = degrees + 90 * rigid - (sign < 0 ? 180 : 0), away = Math.abs(angle - 360 * Math.round(angle / 360));
      const cost = 90 * Math.abs(slope + rigid) + away;
      if (cost < best.cost) best = { cost, rigid, sign };
    }
  }
  const { rigid, sign } = best, { position, drive } = machine.units;
  const turned = sign < 0 ? { hz, re: re.map((value) => -value), im: im.map((value) => -value) } : machine.measured;
  const units = { "m N": "kg", "rad N m": "kg m^2" };
  return {
    ...machine,
    measured: turned,
    turned: Boolean(machine.turned) !== sign < 0,
    mass: 1 / [...sizes].sort((a, b) => a - b)[count >> 1],
    mass_unit: units[`${position} ${drive}`] ?? `${drive}/(${position}/s^2)`,
    rigid,
    first: `slope ${slope.toFixed(2)} and phase ${(degrees - (sign < 0 ? 180 * Math.sign(degrees) : 0)).toFixed(0)}° of the first octave`,
  };
}

// A machine that `python -m stillwork desk FILE --out machine.json` wrote; null for other files.
export function machineOfJson(text) {
  let found;
  try {
    found = JSON.parse(text);
  } catch {
    throw new Error("it is no JSON");
  }
  if (!found || typeof found.name !== "string" || !found.units) return null;
  if (found.model && found.mass > 0) return found;
  return found.measured ? measuredAlone(found) : null;
}

const FORMAT = "stillwork controller 1";

// Blocks out of the controller.json of a design; `machine` is what they are to be used with.
export function designOfController(text, machine) {
  let entries;
  try {
    entries = JSON.parse(text);
  } catch {
    throw new Error("it is no JSON");
  }
  if (entries?.format !== FORMAT || !entries.gains) throw new Error("it is not the controller.json that `design` writes");
  const { gains, provenance = {} } = entries, time = entries.sample_time_s, turn = 2 * Math.PI;
  const per = provenance.encoder_counts || provenance.motor_constant;
  const blocks = [
    {
      kind: "pid",
      gain: gains.gain,
      integrator_hz: gains.integrator / turn,
      differentiator_hz: gains.differentiator / turn,
      low_pass_hz: gains.low_pass / turn,
      damping: gains.low_pass_damping,
    },
    ...(gains.notches ?? []).map((notch) => ({
      kind: "notch",
      frequency_hz: ((2 / time) * Math.atan((notch.omega * time) / 2)) / turn,
      skew: 1,
      depth: notch.depth,
      width: notch.width,
    })),
  ];
  const settings = provenance.settings, application = settings?.application;
  if (application) {
    blocks.push({
      kind: "observer",
      compensate: application.compensate,
      damping: Array.isArray(application.damping) ? application.damping[0] : application.damping,
      selectivity: application.selectivity ?? 2,
      retained: settings.retained,
      ...settings.intensities,
    });
  }
  blocks.push({ kind: "sampling", rate_hz: 1 / time });
  const late = (provenance.delay_samples_of_the_loop ?? 0) * time - Math.max(machine?.delay_s ?? 0, 0);
  blocks.push({ kind: "delay", delay_us: Math.max(late, 0) * 1e6 });
  const wait = settings?.wait ?? 0;
  if (!Number.isInteger(wait)) throw new Error(`its controller waits ${wait} samples, a part of one through an all-pass, for which there is no block`);
  if (wait) blocks.push({ kind: "wait", samples: wait });
  const limit = entries.high?.[0], notes = [];
  if (per) notes.push("its gains stand in the machine's units; its file's limits in the drive's own");
  const mine = provenance.resonances_hz, own = machine?.model?.omega.filter((w) => w > 0).map((w) => w / turn);
  if (mine && own && (mine.length !== own.length || mine.some((f, k) => Math.abs(f / own[k] - 1) > 0.01))) {
    notes.push(`it was made for resonances at ${mine.map((f) => f.toFixed(1)).join(", ")} Hz, not for this machine`);
  }
  return { design: { blocks, limit: Number.isFinite(limit) && !per ? limit : null }, notes };
}
