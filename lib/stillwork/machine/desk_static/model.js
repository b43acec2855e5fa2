// A machine's modal model: held modes in closed form, its response in either time, and its places in the box.
import { complexArray, resonanceGrid } from "./complex.js";

// Whole samples of a delay and the part beside them.
export function splitDelay(samples) {
  const whole = Math.floor(samples + 1e-9), late = samples - whole;
  return [whole, late > 1e-9 ? late : 0];
}

// Transition [p11, p12, p21, p22] and input gains [g1, g2] of one mode (mass 1) over a sample with its force held.
export function heldMode(w, z, time, drag = 0) {
  if (w === 0 && drag) {
    const lost = drag * time, once = (time * -Math.expm1(-lost)) / lost;
    let twice = (lost + Math.expm1(-lost)) / (lost * lost);
    if (lost < 0.1) {
      // 1/2 - x/6 + ...: the closed form cancels where little is lost
      twice = 0;
      for (let k = 7, term; k >= 0; k--) {
        term = (-lost) ** k;
        for (let j = 2; j <= k + 2; j++) term /= j;
        twice += term;
      }
    }
    return [1, once, 0, Math.exp(-lost), time * time * twice, once];
  }
  if (z >= 1) {
    // Two real poles, p and q; each exponential decays by itself.
    const root = Math.sqrt(z * z - 1), p = w * (z - root), apart = 2 * w * root;
    const slow = Math.exp(-p * time), fast = slow * Math.exp(-apart * time);
    const sinc = apart * time < 1e-8 ? slow * time : (slow * -Math.expm1(-apart * time)) / apart;
    const mean = (slow + fast) / 2, drawn = z * w * sinc;
    return [mean + drawn, sinc, -w * w * sinc, mean - drawn, (1 - mean - drawn) / (w * w), sinc];
  }
  const s = Math.sqrt(1 - z * z), angle = w * s * time, decay = Math.exp(-z * w * time), tilt = z / s;
  const sine = Math.sin(angle), cosine = Math.cos(angle);
  const sinc = angle === 0 ? time : (time * sine) / angle;
  const half = Math.sin(angle / 2);
  const lifted = -Math.expm1(-z * w * time) + decay * (2 * half * half - tilt * sine);
  return [
    decay * (cosine + tilt * sine),
    decay * sinc,
    -decay * w * w * sinc,
    decay * (cosine - tilt * sine),
    w > 0 ? lifted / (w * w) : (time * time) / 2,
    decay * sinc,
  ];
}

// As `heldMode`, of a force that begins late by a part of a sample: [..., g1, g2, old1, old2].
export function lateMode(w, z, time, late, drag = 0) {
  const held = heldMode(w, z, time, drag);
  if (!late) return [...held, 0, 0];
  const after = heldMode(w, z, (1 - late) * time, drag), old = heldMode(w, z, late * time, drag);
  const o1 = after[0] * old[4] + after[1] * old[5], o2 = after[2] * old[4] + after[3] * old[5];
  return [...held.slice(0, 4), after[4], after[5], o1, o2];
}

// Adds `gain` times the response of one mode (mass 1) to `sum`.
export function addMode(sum, gain, w, z, omega, sampleTime, late, drag = 0) {
  const { re, im } = sum;
  if (!sampleTime) {
    const loss = w > 0 ? 2 * z * w : drag;
    for (let k = 0; k < omega.length; k++) {
      const a = w * w - omega[k] * omega[k], b = loss * omega[k], size = a * a + b * b;
      re[k] += (gain * a) / size;
      im[k] -= (gain * b) / size;
    }
    return;
  }
  const [p11, p12, p21, p22, g1, g2, o1, o2] = lateMode(w, z, sampleTime, late, drag);
  const first = p11 - 1, second = p22 - 1, trace = first + second, rest = first * second - p12 * p21;
  for (let k = 0; k < omega.length; k++) {
    const t = omega[k] * sampleTime, half = Math.sin(t / 2), x = -2 * half * half, y = Math.sin(t);
    // determinant = lifted^2 - lifted trace + rest, lifted = exp(jt) - 1
    const c = x * x - y * y - x * trace + rest, d = 2 * x * y - y * trace;
    let p = g1, q = 0, v = g2, u = 0;
    if (late) {
      const cosine = 1 + x;
      p += cosine * o1;
      q = -y * o1;
      v += cosine * o2;
      u = -y * o2;
    }
    const a = (x - second) * p - y * q + p12 * v, b = (x - second) * q + y * p + p12 * u;
    const size = c * c + d * d;
    re[k] += (gain * (a * c + b * d)) / size;
    im[k] += (gain * (b * c - a * d)) / size;
  }
}

export const residues = (model) => model.input.map((value, k) => value * model.output[k]);

// Response from force to position; `place` moves the model within its box.
export function plantResponse(model, omega, sampleTime, delay, place = null) {
  const sum = complexArray(omega.length);
  const gain = place ? place.gain : 1;
  const samples = sampleTime ? Math.max((delay + (place ? place.delay : 0)) / sampleTime, 0) : 0;
  const [whole, late] = splitDelay(samples);
  const drag = Math.max((model.drag ?? 0) + (place?.friction ?? 0), 0);
  residues(model).forEach((residue, k) => {
    const w = model.omega[k] * (place ? place.frequencies[k] : 1);
    const z = Math.min(model.damping[k] * (place ? place.damping[k] : 1), 0.999);
    addMode(sum, residue * gain * (place ? place.residues[k] : 1), w, z, omega, sampleTime, late, drag);
  });
  const through = model.feedthrough * gain;
  for (let k = 0; k < omega.length; k++) {
    let a = sum.re[k] + through, b = sum.im[k], turn = -omega[k] * Math.max(delay + (place ? place.delay : 0), 0);
    if (sampleTime) {
      const t = omega[k] * sampleTime; // it shows the force of the sample before
      a += through * (Math.cos(t) - 1);
      b -= through * Math.sin(t);
      turn = -t * whole;
    }
    const c = Math.cos(turn), s = Math.sin(turn);
    sum.re[k] = a * c - b * s;
    sum.im[k] = a * s + b * c;
  }
  return sum;
}

// Grid of a model: in logarithms, and dense at its modes and at the ends of their intervals.
export function modelGrid(model, low, high, points = 500, around = 24) {
  const poles = [];
  model.omega.forEach((w, k) => {
    if (!w) return;
    const share = model.uncertainty ? model.uncertainty.frequency[k] : 0;
    for (const factor of share ? [1 - share, 1, 1 + share] : [1]) {
      poles.push({ omega: w * factor, width: w * model.damping[k] });
    }
  });
  return resonanceGrid(poles, low, high, points, around);
}

export const boxIsEmpty = (box) =>
  !box || !(box.gain || box.mass || box.delay || box.friction || [...box.frequency, ...box.residue, ...box.damping].some((x) => x));

// Corners of the box that are shown while a block is dragged: each mode and all of them lower and higher, with either
// gain. The whole box is searched when the hand rests.
export function corners(model) {
  const box = model.uncertainty, places = [];
  if (boxIsEmpty(box)) return places;
  const sides = [model.omega.map(() => -1), model.omega.map(() => 1)];
  const flexible = model.omega.map((_, k) => k).filter((k) => box.frequency[k] > 0);
  if (flexible.length > 1) {
    for (const k of flexible.slice(0, 6)) {
      for (const sign of [-1, 1]) sides.push(model.omega.map((_, j) => (j === k ? sign : -sign)));
    }
  }
  for (const side of sides) {
    for (const sign of box.gain || box.delay || box.friction ? [-1, 1] : [1]) {
      places.push({
        frequencies: side.map((s, k) => 1 + s * box.frequency[k]),
        residues: side.map((_, k) => (k ? 1 : sign > 0 ? 1 / (1 - box.mass) : 1 / (1 + box.mass))),
        damping: box.damping.map((share) => 1 - share),
        gain: 1 + sign * box.gain,
        delay: sign * box.delay,
        friction: -sign * (box.friction ?? 0),
      });
    }
  }
  return places;
}
