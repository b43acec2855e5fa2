// What leaves the desk: controller.json for `stillwork export`, and the design as text.
import { toDb } from "./complex.js";
import { FUNCTIONS, SHOWN } from "./loop.js";
import { makeObserver, product, zeros } from "./observer.js";
import { BLOCKS, activeBlocks, biquads, integrators, timing } from "./response.js";

const rows = (m) => Array.from({ length: m.rows }, (_, r) => [...m.at.slice(r * m.cols, (r + 1) * m.cols)]);

// Time in which the integrator follows a limited force: the root of integral and differential time where there is a PID.
export function trackingTime(design) {
  const pid = activeBlocks(design).find((block) => block.kind === "pid");
  const integrator = activeBlocks(design).find((block) => block.kind === "integrator");
  if (pid) return 1 / (2 * Math.PI * Math.sqrt(pid.integrator_hz * pid.differentiator_hz));
  return integrator ? 1 / (2 * Math.PI * integrator.zero_hz) : 0;
}

// One biquad's states turn as its poles do: of its coefficients near z = 1 a few digits would be all that is left.
function realised([b0, b1, b2, , a1, a2]) {
  const n1 = b1 - a1 * b0, n0 = b2 - a2 * b0, square = (a1 * a1) / 4 - a2;
  if (square < 0) {
    const turn = Math.sqrt(-square), middle = -a1 / 2;
    return { a: [middle, turn, -turn, middle], b: [0, 1], c: [(n0 + n1 * middle) / turn, n1], d: b0 };
  }
  const outer = -a1 / 2 - (Math.sign(a1) || 1) * Math.sqrt(square), inner = outer ? a2 / outer : 0;
  return { a: [outer, 1, 0, inner], b: [0, 1], c: [n0 + n1 * outer, n1], d: b0 };
}

function place(into, part, row, col) {
  for (let i = 0; i < part.rows; i++) for (let j = 0; j < part.cols; j++) into.at[(row + i) * into.cols + col + j] += part.at[i * part.cols + j];
}
const matrix = (rows, cols, at) => ({ rows, cols, at: Float64Array.from(at) });

// The whole controller with its observer, as `design` writes it: from (e, f - u), the limited force beside what is fed
// forward included, to the command.
export function observedController(machine, design) {
  const { sampleTime, delay, observer: block } = timing(design);
  const own = makeObserver(machine.model, machine.mass, block, sampleTime, delay + Math.max(machine.delay_s || 0, 0));
  const line = own.whole, n = own.a.rows, filters = own.filters.length, sections = biquads(design).map(realised);
  const size = line + n + 2 * filters + 2 * sections.length, first = line, bands = line + n, pid = bands + 2 * filters;
  const a = zeros(size, size), b = zeros(size, 2), c = zeros(1, size), d = zeros(1, 2);
  // What delays the force, the newest at its beginning.
  if (line) b.at[1] = 1;
  for (let k = 1; k < line; k++) a.at[k * size + k - 1] = 1;
  place(a, own.a, first, first);
  for (let i = 0; i < n; i++) {
    if (line) a.at[(first + i) * size + line - 1] += own.b.at[2 * i];
    else b.at[(first + i) * 2 + 1] += own.b.at[2 * i];
    b.at[(first + i) * 2] -= own.b.at[2 * i + 1]; // the observer sees -e
  }
  own.filters.forEach(({ held: [p11, p12, p21, p22, g1, g2], gain }, k) => {
    const row = bands + 2 * k, read = matrix(1, n, own.c.at.slice((k + 1) * n, (k + 2) * n));
    place(a, matrix(2, 2, [p11, p12, p21, p22]), row, row);
    place(a, product(matrix(2, 1, [g1, g2]), read), row, first);
    b.at[row * 2] -= g1 * own.d[k + 1];
    b.at[(row + 1) * 2] -= g2 * own.d[k + 1];
    c.at[row + 1] += gain;
  });
  // e + y_flex goes through the sections one after the other.
  let reads = zeros(1, size), direct = zeros(1, 2);
  place(reads, matrix(1, n, own.c.at.slice(0, n)), 0, first);
  direct.at[0] = 1 - own.d[0];
  sections.forEach((section, k) => {
    const row = pid + 2 * k, into = matrix(2, 1, section.b);
    place(a, matrix(2, 2, section.a), row, row);
    place(a, product(into, reads), row, 0);
    place(b, product(into, direct), row, 0);
    reads = { ...reads, at: reads.at.map((x) => x * section.d) };
    direct = { ...direct, at: direct.at.map((x) => x * section.d) };
    place(reads, matrix(1, 2, section.c), 0, row);
  });
  place(c, reads, 0, 0);
  place(d, direct, 0, 0);
  return { a, b, c, d };
}

// The controller as a table that `export` turns into C: `rate_hz` and either biquads or state space.
export function controllerJson(machine, design) {
  const { sampleTime, delay, own, observer } = timing(design);
  if (!sampleTime) throw new Error("a controller runs sampled: add a sampling block");
  const { position, drive } = machine.units;
  const controller = { rate_hz: 1 / sampleTime, inputs: [`e (${position})`], outputs: [`f (${drive})`] };
  if (observer && (observer.compensate || observer.damping > 0)) {
    // Of two columns of b and d the first is e, the second the limited output beside what is fed forward.
    for (const [name, values] of Object.entries(observedController(machine, design))) controller[name] = rows(values);
  } else {
    controller.biquads = biquads(design);
  }
  if (own) controller.delay_samples = own; // with what is fed forward
  const count = integrators(design);
  // Integrators in a row would wind up at a limit.
  if (design.limit > 0 && count <= 1) {
    Object.assign(controller, { low: -design.limit, high: design.limit });
    if (count) controller.tracking_time_s = trackingTime(design);
  }
  const late = delay + Math.max(machine.delay_s || 0, 0) + sampleTime / 2;
  if (machine.model && !(machine.model.omega[0] > 0) && (design.move?.feedforward ?? true)) {
    controller.motion = { lag_s: late, feedforward: { acceleration: machine.mass } };
  }
  return `${JSON.stringify({ machine: machine.name, controller }, null, 1)}\n`;
}

// A bandwidth in words: a loop that stays below 0 dB has none.
export const bandwidthText = (value, digits) => (value > 0 ? `${value.toFixed(digits)} Hz` : "none (no crossing)");

// The design in words and numbers.
export function designText(machine, design, result) {
  const lines = [machine.name, `mass ${machine.mass.toPrecision(4)} ${machine.mass_unit}`];
  for (const block of activeBlocks(design)) {
    const { title, numbers } = BLOCKS[block.kind];
    const values = Object.entries(numbers).map(([name, { label, unit }]) => `${label} ${Number(block[name]).toPrecision(5)}${unit && unit !== "force" ? ` ${unit}` : ""}`);
    if (block.kind === "observer") values.unshift(block.compensate ? "MC" : "no MC");
    lines.push(`${title}: ${values.join(", ")}`);
  }
  lines.push(`bandwidth ${bandwidthText(result.bandwidth, 2)}, ${result.stable ? "stable" : "unstable"}`);
  for (const name of FUNCTIONS) {
    const own = result.nominal[name], box = result.box?.[name];
    const there = box ? `, in the box ${toDb(box.size).toFixed(2)} dB at ${box.hz.toFixed(1)} Hz` : "";
    lines.push(`${SHOWN[name]}: ${toDb(own.size).toFixed(2)} dB at ${own.hz.toFixed(1)} Hz${there}`);
  }
  return `${lines.join("\n")}\n`;
}
