// What is being designed: a list of blocks, kept in the address, with undo and a ghost of before.

// A design to begin with: the rules of Table 3.3 at a bandwidth far below the first resonance, sampled and late.
export function firstDesign(machine) {
  const start = machine.start ?? {};
  const resonance = machine.model ? Math.min(...machine.model.omega.filter((w) => w > 0)) / (2 * Math.PI) : 0;
  const hz = start.bandwidth_hz ?? (resonance ? resonance / 20 : machine.measured.hz[0] * 2);
  const rate = start.rate_hz ?? (resonance ? niceRate(40 * resonance) : niceRate(4 * machine.measured.hz[machine.measured.hz.length - 1]));
  return {
    blocks: [
      pidBlock(machine.mass, hz),
      { kind: "sampling", rate_hz: rate },
      { kind: "delay", delay_us: (1e6 * (start.delay_samples ?? 1)) / rate },
    ],
    limit: null,
  };
}

export const pidBlock = (mass, hz) => ({
  kind: "pid",
  gain: (mass * (2 * Math.PI * hz) ** 2) / 3,
  integrator_hz: hz / 9,
  differentiator_hz: hz / 3,
  low_pass_hz: 3 * hz,
  damping: 0.7,
});

export function niceRate(hz) {
  const decade = 10 ** Math.floor(Math.log10(hz));
  return decade * [1, 2, 4, 5, 10].find((step) => step * decade >= hz * (1 - 1e-9));
}

// A block of a kind with numbers that fit where the loop crosses (Hz).
export function newBlock(kind, machine, design, crossing) {
  const hz = crossing > 0 ? crossing : 10;
  const resonance = machine.model ? machine.model.omega.find((w) => w > 0) / (2 * Math.PI) : 3 * hz;
  const block = {
    gain: { value: 1 },
    pid: pidBlock(1, hz),
    lead: { zero_hz: hz / 3, pole_hz: hz * 3 },
    lag: { zero_hz: hz / 5, pole_hz: hz / 20 },
    integrator: { zero_hz: hz / 10 },
    notch: { frequency_hz: resonance, skew: 1, depth: 0.01, width: 0.1 },
    low_pass_1: { corner_hz: 5 * hz },
    low_pass_2: { corner_hz: 5 * hz, damping: 0.7 },
    delay: { delay_us: 10 },
    wait: { samples: 1 },
    sampling: { rate_hz: niceRate(100 * hz) },
    observer: { compensate: true, damping: 0, selectivity: 2, retained: 5, disturbance: 8e-4, sensor: 1.41e-9, drift: 1.92e-4 },
  }[kind];
  if (kind === "pid" && design.blocks.some((each) => each.kind === "pid")) block.gain = 1;
  else if (kind === "pid") block.gain = pidBlock(machine.mass, hz).gain;
  return { ...block, kind };
}

// A number as it is typed or pasted: a point or a comma before decimals, spaces between thousands, any minus sign. What
// may be two numbers, or none, is refused.
export function typedNumber(text) {
  const plain = text.trim().replace(/[\u2212\u2013]/g, "-"), ungrouped = plain.replace(/(?<=\d)[\s](?=\d{3}(?!\d))/g, "");
  if (/^[+-]?[1-9]\d{0,2},\d{3}(e[+-]?\d+)?$/i.test(ungrouped)) {
    throw new Error(`${plain} may be ${ungrouped.replace(",", ".")} or ${ungrouped.replace(",", "")}: write one of them`);
  }
  if (!/^[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?$/i.test(ungrouped)) throw new Error(plain ? `${plain} is no number` : "it is empty");
  return Number(ungrouped.replace(",", "."));
}

const toBase64 = (text) => btoa(unescape(encodeURIComponent(text))).replace(/\+/g, "-").replace(/\//g, "_").replace(/=+$/, "");
const fromBase64 = (text) => decodeURIComponent(escape(atob(text.replace(/-/g, "+").replace(/_/g, "/"))));

export const toAddress = (machineName, design) => `#d=${toBase64(JSON.stringify({ machine: machineName, design }))}`;

// What an address holds: {machine, design}, or null.
export function fromAddress(hash) {
  const found = hash.match(/^#d=([\w-]+)$/);
  if (!found) return null;
  try {
    const { machine, design } = JSON.parse(fromBase64(found[1]));
    return Array.isArray(design?.blocks) ? { machine, design } : null;
  } catch {
    return null;
  }
}

// The present design and those before and after it. A drag or a run of typed steps is one step of the history.
export function makeHistory(first) {
  let at = 0, held = null;
  const past = [first];
  return {
    get now() {
      return held ?? past[at];
    },
    // While something is being dragged.
    hold(design) {
      held = design;
    },
    put(design) {
      held = null;
      if (JSON.stringify(design) === JSON.stringify(past[at])) return;
      past.splice(at + 1, Infinity, design);
      if (past.length > 500) past.shift();
      at = past.length - 1;
    },
    get settled() {
      return past[at];
    },
    undo() {
      held = null;
      at = Math.max(at - 1, 0);
      return past[at];
    },
    redo() {
      held = null;
      at = Math.min(at + 1, past.length - 1);
      return past[at];
    },
    get canUndo() {
      return at > 0;
    },
    get canRedo() {
      return at < past.length - 1;
    },
  };
}
