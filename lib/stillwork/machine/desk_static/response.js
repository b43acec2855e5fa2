// The blocks of a controller: their numbers, their sections in s, and their responses.
import { complexArray, multiplyInto } from "./complex.js";

const TURN = 2 * Math.PI;

// Of each kind of block its numbers: what is typed, its unit, its bounds, and what a search may change.
const hertz = (label) => ({ label, unit: "Hz", low: 1e-3, high: 1e6, free: true });
const ratio = (label, low = 1e-5, high = 10) => ({ label, unit: "", low, high, free: true });
export const BLOCKS = {
  gain: { title: "Gain", numbers: { value: { label: "gain", unit: "force", low: 1e-12, high: 1e15, free: true } } },
  pid: {
    title: "PID",
    numbers: {
      gain: { label: "gain", unit: "force", low: 1e-12, high: 1e15, free: true },
      integrator_hz: hertz("integrator"),
      differentiator_hz: hertz("differentiator"),
      low_pass_hz: hertz("low-pass"),
      damping: ratio("low-pass damping", 0.05, 2),
    },
  },
  lead: { title: "Lead", numbers: { zero_hz: hertz("zero"), pole_hz: hertz("pole") } },
  lag: { title: "Lag", numbers: { zero_hz: hertz("zero"), pole_hz: hertz("pole") } },
  integrator: { title: "Integrator", numbers: { zero_hz: hertz("zero") } },
  notch: {
    title: "Notch",
    numbers: {
      frequency_hz: hertz("zeros"),
      skew: { ...ratio("poles over zeros", 0.1, 10), free: true },
      depth: ratio("damping of zeros", 0, 10),
      width: ratio("damping of poles", 1e-4, 10),
    },
  },
  low_pass_1: { title: "Low-pass, first order", numbers: { corner_hz: hertz("corner") } },
  low_pass_2: {
    title: "Low-pass, second order",
    numbers: { corner_hz: hertz("corner"), damping: ratio("damping", 0.05, 2) },
  },
  delay: { title: "Delay", numbers: { delay_us: { label: "delay", unit: "µs", low: 0, high: 1e6, free: false } } },
  wait: {
    title: "Own delay",
    numbers: { samples: { label: "samples that the controller waits", unit: "", low: 0, high: 1000, free: false, whole: true } },
  },
  sampling: { title: "Sampling", numbers: { rate_hz: { label: "rate", unit: "Hz", low: 1, high: 1e7, free: false } } },
  observer: {
    title: "Observer",
    numbers: {
      damping: { label: "AD: damping added", unit: "", low: 0, high: 0.9, free: true },
      selectivity: { label: "AD: quality of band-passes", unit: "", low: 0.05, high: 100, free: true },
      retained: { label: "modes held, body included", unit: "", low: 2, high: 12, free: false, whole: true },
      disturbance: { label: "disturbance", unit: "acceleration/√Hz", low: 1e-12, high: 1e6, free: true },
      sensor: { label: "sensor noise", unit: "position/√Hz", low: 1e-18, high: 1e3, free: true },
      drift: { label: "drift of the disturbance", unit: "", low: 1e-15, high: 1e12, free: true },
    },
  },
};

// Where Tustin's rule takes a frequency from (rad/s); without sampling it stays.
export function prewarped(omega, sampleTime) {
  if (!sampleTime) return omega;
  const angle = Math.min((omega * sampleTime) / 2, 0.499 * Math.PI);
  return (2 / sampleTime) * Math.tan(angle);
}

// Sections of a block in s, each {num, den} of three coefficients, the highest power first.
export function sectionsOf(block, sampleTime = 0) {
  const w = (name) => TURN * block[name];
  switch (block.kind) {
    case "gain":
      return [{ num: [0, 0, block.value], den: [0, 0, 1] }];
    case "pid": {
      const low = w("low_pass_hz");
      return [
        { num: [0, block.gain, block.gain * w("integrator_hz")], den: [0, 1, 0] },
        { num: [0, (low * low) / w("differentiator_hz"), low * low], den: [1, 2 * block.damping * low, low * low] },
      ];
    }
    case "lead":
      return [{ num: [0, 1 / w("zero_hz"), 1], den: [0, 1 / w("pole_hz"), 1] }];
    case "lag":
      return [{ num: [0, 1, w("zero_hz")], den: [0, 1, w("pole_hz")] }];
    case "integrator":
      return [{ num: [0, 1, w("zero_hz")], den: [0, 1, 0] }];
    case "notch": {
      // A notch stands where it was typed, sampled or not.
      const zeros = prewarped(w("frequency_hz"), sampleTime);
      const poles = prewarped(w("frequency_hz") * block.skew, sampleTime);
      const scale = (poles / zeros) ** 2;
      return [
        {
          num: [scale, scale * 2 * block.depth * zeros, poles * poles],
          den: [1, 2 * block.width * poles, poles * poles],
        },
      ];
    }
    case "low_pass_1":
      return [{ num: [0, 0, w("corner_hz")], den: [0, 1, w("corner_hz")] }];
    case "low_pass_2": {
      const corner = w("corner_hz");
      return [{ num: [0, 0, corner * corner], den: [1, 2 * block.damping * corner, corner * corner] }];
    }
    default: // delay, wait, sampling and observer are no filters of the error
      return [];
  }
}

export const isFilter = (block) => !["delay", "wait", "sampling", "observer"].includes(block.kind);
export const activeBlocks = (design) => design.blocks.filter((block) => !block.off);

// Sample time (s) and delay (s) of a design, and its observer, if it has one; of the delay, the controller's own samples.
export function timing(design) {
  const blocks = activeBlocks(design);
  const sampling = blocks.find((block) => block.kind === "sampling");
  const delay = blocks.filter((block) => block.kind === "delay").reduce((sum, block) => sum + block.delay_us * 1e-6, 0);
  const own = blocks.filter((block) => block.kind === "wait").reduce((sum, block) => sum + block.samples, 0);
  const sampleTime = sampling ? 1 / sampling.rate_hz : 0;
  return {
    sampleTime,
    delay: delay + own * sampleTime,
    own,
    observer: blocks.find((block) => block.kind === "observer") ?? null,
  };
}

export const integrators = (design) =>
  activeBlocks(design).filter((block) => block.kind === "pid" || block.kind === "integrator").length;

export const controllerSections = (design, sampleTime) =>
  activeBlocks(design)
    .filter(isFilter)
    .flatMap((block) => sectionsOf(block, sampleTime));

// What the sections see: omega without sampling, else where Tustin's rule takes them from.
export function tustinAxis(omega, sampleTime) {
  return sampleTime ? omega.map((w) => (2 / sampleTime) * Math.tan((w * sampleTime) / 2)) : omega;
}

export function sectionsResponse(sections, axis) {
  const response = complexArray(axis.length, 1);
  const { re, im } = response;
  for (const { num, den } of sections) {
    const [n2, n1, n0] = num, [d2, d1, d0] = den;
    for (let k = 0; k < axis.length; k++) {
      const v = axis[k], vv = v * v;
      const a = n0 - n2 * vv, b = n1 * v, c = d0 - d2 * vv, d = d1 * v;
      const size = c * c + d * d;
      const x = (a * c + b * d) / size, y = (b * c - a * d) / size;
      const real = re[k] * x - im[k] * y;
      im[k] = re[k] * y + im[k] * x;
      re[k] = real;
    }
  }
  return response;
}

// A zero-order hold with a delay (s), before the aliases that it folds back.
export function holdResponse(omega, sampleTime, delay) {
  const response = complexArray(omega.length, 1);
  for (let k = 0; k < omega.length; k++) {
    const half = (omega[k] * sampleTime) / 2, size = half === 0 ? 1 : Math.sin(half) / half;
    const angle = -half - omega[k] * delay;
    response.re[k] = size * Math.cos(angle);
    response.im[k] = size * Math.sin(angle);
  }
  return response;
}

export function delayResponse(omega, delay) {
  const response = complexArray(omega.length);
  for (let k = 0; k < omega.length; k++) {
    response.re[k] = Math.cos(omega[k] * delay);
    response.im[k] = -Math.sin(omega[k] * delay);
  }
  return response;
}

export const controllerResponse = (design, omega) => {
  const { sampleTime } = timing(design);
  return sectionsResponse(controllerSections(design, sampleTime), tustinAxis(omega, sampleTime));
};

// Tustin's rule on each section, two of first order put together: (b0, b1, b2, 1, a1, a2) each.
export function biquadsOf(sections, sampleTime) {
  const rate = 2 / sampleTime;
  const first = [], whole = [];
  let gain = 1;
  for (const { num, den } of sections) {
    const order = den[0] !== 0 ? 2 : den[1] !== 0 ? 1 : 0;
    if (order === 0) gain *= num[2] / den[2];
    else if (order === 1) {
      const [, n1, n0] = num, [, d1, d0] = den, scale = d1 * rate + d0;
      first.push([(n1 * rate + n0) / scale, (n0 - n1 * rate) / scale, (d0 - d1 * rate) / scale]);
    } else {
      const [n2, n1, n0] = num, [d2, d1, d0] = den, square = rate * rate;
      const scale = d2 * square + d1 * rate + d0;
      whole.push([
        (n2 * square + n1 * rate + n0) / scale,
        (2 * (n0 - n2 * square)) / scale,
        (n2 * square - n1 * rate + n0) / scale,
        1,
        (2 * (d0 - d2 * square)) / scale,
        (d2 * square - d1 * rate + d0) / scale,
      ]);
    }
  }
  for (let k = 0; k < first.length; k += 2) {
    const [b0, b1, a1] = first[k], [c0, c1, e1] = first[k + 1] ?? [1, 0, 0];
    whole.unshift([b0 * c0, b0 * c1 + b1 * c0, b1 * c1, 1, a1 + e1, a1 * e1]);
  }
  if (!whole.length) whole.push([1, 0, 0, 1, 0, 0]);
  for (let k = 0; k < 3; k++) whole[0][k] *= gain;
  return whole;
}

export const biquads = (design) => {
  const { sampleTime } = timing(design);
  return biquadsOf(controllerSections(design, sampleTime), sampleTime);
};

export function biquadsResponse(rows, omega, sampleTime) {
  const response = complexArray(omega.length, 1);
  const one = complexArray(omega.length);
  for (const [b0, b1, b2, , a1, a2] of rows) {
    for (let k = 0; k < omega.length; k++) {
      const t = omega[k] * sampleTime, c1 = Math.cos(t), s1 = -Math.sin(t), c2 = Math.cos(2 * t), s2 = -Math.sin(2 * t);
      const a = b0 + b1 * c1 + b2 * c2, b = b1 * s1 + b2 * s2, c = 1 + a1 * c1 + a2 * c2, d = a1 * s1 + a2 * s2;
      const size = c * c + d * d;
      one.re[k] = (a * c + b * d) / size;
      one.im[k] = (b * c - a * d) / size;
    }
    multiplyInto(response, one);
  }
  return response;
}
