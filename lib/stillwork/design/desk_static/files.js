// Files that are dropped: a frequency response as CSV, or the controller.json of a design.

const GRAVITY = 9.80665;
const PREFIXES = { "": 1, m: 1e-3, u: 1e-6, n: 1e-9, k: 1e3 };
const POSITIONS = ["m", "rad", "count"], DRIVES = ["N", "N m", "A", "V"];
const FREQUENCIES = ["frequency", "frequencies", "freq", "freqs", "f", "hz", "hertz", "omega"];
const ANGLES = [...FREQUENCIES, "phase", "angle", "w"];
const PLAIN = ["", "-", "1", "s", "ms", "rad", "deg", "degrees", "°", "hz", "khz", "rad/s"]; // in brackets of time, phase, frequency and coherence
export const RESPONSE_UNITS = POSITIONS.flatMap((each) => ["/s^2", "/s", ""].map((over) => each + over));
export const DRIVE_UNITS = DRIVES;

// Factor to SI and the unit there; null for one that no machine has.
export function unitFactor(text) {
  let plain = text.trim().replace(/[µμ]/g, "u").replace("²", "^2").replace("s2", "s^2").replace("counts", "count");
  plain = plain.replace(/^([munk]?)N[-*· ]?m$/, "$1N m");
  const gravity = plain.match(/^([mun]?)g$/);
  if (gravity) return [PREFIXES[gravity[1]] * GRAVITY, "m/s^2"];
  for (const unit of [...RESPONSE_UNITS, ...DRIVES]) {
    for (const [prefix, factor] of Object.entries(PREFIXES)) if (plain === prefix + unit) return [factor, unit];
  }
  return null;
}

const wordOf = (name) => name.toLowerCase().trim().split(/[\s([_\d]/)[0];
const bracketOf = (name) => (name.match(/[([](.+)[)\]]/)?.[1] ?? "").trim().toLowerCase();

// What stands in the brackets at the end of a name, after `dB re 1`.
const inBrackets = (name) => (name.match(/[([](.+)[)\]]\s*$/)?.[1] ?? "").replace(/^dB\b\s*((re\s*)?1\s+|re\s+)?/i, "");
const isOne = (text, units) => units.includes(unitFactor(text)?.[1]);

// Units of response and drive that the names state: {response, drive}, empty where none does.
export function statedUnits(names) {
  const found = { response: "", drive: "" };
  for (const name of names) {
    const whole = inBrackets(name), cut = whole.lastIndexOf("/");
    const [top, below] = [whole.slice(0, Math.max(cut, 0)), whole.slice(cut + 1)].map((each) => each.replace(/^[() ]+|[() ]+$/g, ""));
    if (isOne(top, RESPONSE_UNITS) && isOne(below, DRIVES)) {
      found.response ||= top;
      found.drive ||= below;
    } else if (!ANGLES.includes(wordOf(name))) {
      // rad and rad/s behind a phase and a frequency are no motion of the machine.
      if (isOne(whole, RESPONSE_UNITS)) found.response ||= whole;
      if (isOne(whole, DRIVES)) found.drive ||= whole;
    }
  }
  return found;
}

// Columns of a table of numbers by name; lines with # in front are skipped.
export function parseTable(text) {
  const lines = text.replace(/^\uFEFF/, "").split(/\r?\n/).map((line) => line.split("#")[0].trim()).filter(Boolean);
  if (lines.length < 2) throw new Error("it holds no table: give a line of names and rows of numbers");
  const body = lines[1];
  const mark = ["\t", ";", ","].find((each) => body.includes(each));
  const decimal = mark === ";" && body.includes(",") && !body.includes(".") ? "," : ".";
  const fields = (line) => (mark ? line.split(mark) : line.split(/\s+/)).map((each) => each.trim().replace(/^"(.*)"$/, "$1"));
  const names = mark ? fields(lines[0]) : lines[0].match(/[^\s([]+(?:\s*[([][^)\]]*[)\]]+)?/g);
  if (names.every((each) => each !== "" && Number.isFinite(Number(each.replace(decimal, "."))))) {
    throw new Error("its first line is no line of names; name the columns, e.g. frequency (Hz),real,imaginary");
  }
  const rows = lines.slice(1).map((line, k) => {
    const values = fields(line).map((each) => (each === "" ? NaN : Number(each.replace(decimal, "."))));
    if (values.length < names.length) throw new Error(`row ${k + 1} holds ${values.length} values for ${names.length} columns`);
    return values;
  });
  return Object.fromEntries(names.map((name, k) => [name, rows.map((row) => row[k])]));
}

// A machine out of a CSV file; `units` {response, drive} where the file does not say them.
export function machineOfTable(text, name, units = {}) {
  const columns = parseTable(text), names = Object.keys(columns);
  const column = (...words) => names.find((each) => words.includes(wordOf(each)));
  const axis = column(...FREQUENCIES);
  if (!axis) {
    const raw = column("force", "hammer") || (column("m", "mass") && column("k", "stiffness"));
    throw new Error(
      raw
        ? "hammer records and matrices need a fit: run `python -m stillwork desk FILE`"
        : `it holds ${names.join(", ")}, and no frequency; name it so`,
    );
  }
  const scale = { hz: 1, khz: 1e3, "rad/s": 1 / (2 * Math.PI) }[bracketOf(axis) || (wordOf(axis) === "omega" ? "rad/s" : "hz")];
  if (!scale) throw new Error(`${axis}: give the frequency in Hz, kHz or rad/s`);
  const hz = columns[axis].map((value) => value * scale);
  const real = column("real", "re"), imaginary = column("imaginary", "imag", "im");
  const size = column("magnitude", "mag", "amplitude", "gain"), angle = column("phase", "angle");
  let values;
  if (real && imaginary) values = hz.map((_, k) => [columns[real][k], columns[imaginary][k]]);
  else if (size && angle) {
    const decibels = bracketOf(size).startsWith("db"), radians = bracketOf(angle) === "rad";
    values = hz.map((_, k) => {
      const r = decibels ? 10 ** (columns[size][k] / 20) : columns[size][k];
      const a = radians ? columns[angle][k] : (columns[angle][k] * Math.PI) / 180;
      return [r * Math.cos(a), r * Math.sin(a)];
    });
  } else throw new Error("no response stands beside the frequency; give real and imaginary, or magnitude and phase");
  for (let k = 1; k < hz.length; k++) {
    if (!(hz[k] > hz[k - 1])) throw new Error("the frequency does not rise from line to line; sort the rows");
  }
  const stated = statedUnits(names), notes = [];
  const unknown = names.find((each) => !PLAIN.includes(inBrackets(each).toLowerCase()) && !Object.values(statedUnits([each])).some(Boolean));
  if (unknown) throw new Error(`${unknown}: the unit is not known; use ${RESPONSE_UNITS.join(", ")} over ${DRIVES.join(", ")}, with m, u, n or k in front`);
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
  const limit = entries.high?.[0], notes = [];
  if (per) notes.push("its gains stand in the machine's units; its file's limits in the drive's own");
  const mine = provenance.resonances_hz, own = machine?.model?.omega.filter((w) => w > 0).map((w) => w / turn);
  if (mine && own && (mine.length !== own.length || mine.some((f, k) => Math.abs(f / own[k] - 1) > 0.01))) {
    notes.push(`it was made for resonances at ${mine.map((f) => f.toFixed(1)).join(", ")} Hz, not for this machine`);
  }
  return { design: { blocks, limit: Number.isFinite(limit) && !per ? limit : null }, notes };
}
