// Step and scan on the fitted model, sample by sample.
import { lateMode, splitDelay } from "./model.js";
import { biquadsOf } from "./response.js";

// A move over a distance within limits of velocity, acceleration and jerk: at each sample its acceleration, and its position
// `lag` (s) before, where a late force has taken the machine.
export function thirdOrderMove({ distance, velocity, acceleration, jerk }, sampleTime, rest = 0, lag = 0) {
  let v = velocity, a = acceleration;
  const j = jerk;
  if (!(distance > 0 && v > 0 && a > 0 && j > 0)) throw new Error("give distance, velocity, acceleration and jerk above 0");
  // The limits that the distance lets the move reach.
  a = Math.min(a, Math.cbrt((j * j * distance) / 2));
  a = Math.min(a, Math.sqrt(v * j));
  const ramp = a / j; // of the acceleration
  // v = a (plateau + ramp), distance = v (2 ramp + plateau) without a cruise
  const most = (-ramp + Math.sqrt(ramp * ramp + (4 * distance) / a)) / 2;
  v = Math.min(v, a * most);
  const plateau = Math.max(v / a - ramp, 0), cruise = Math.max(distance / v - (2 * ramp + plateau), 0);
  const phases = [[j, ramp], [0, plateau], [-j, ramp], [0, cruise], [-j, ramp], [0, plateau], [j, ramp]];
  const total = phases.reduce((sum, [, time]) => sum + time, 0);
  const count = Math.ceil((total + rest) / sampleTime) + 1;
  const sampled = (late) => {
    const rows = { position: new Float64Array(count), acceleration: new Float64Array(count) };
    let phase = 0, begin = 0, p = 0, s = 0, b = 0;
    const at = (time) => {
      const [own] = phases[phase];
      return [p + s * time + (b * time * time) / 2 + (own * time ** 3) / 6, s + b * time + (own * time * time) / 2, b + own * time];
    };
    for (let k = 0; k < count; k++) {
      const now = Math.max(k * sampleTime - late, 0);
      while (phase < phases.length && now - begin >= phases[phase][1]) {
        const length = phases[phase][1];
        [p, s, b] = at(length);
        begin += length;
        phase++;
      }
      if (phase < phases.length) [rows.position[k], , rows.acceleration[k]] = at(now - begin);
      else rows.position[k] = distance;
    }
    return rows;
  };
  return { position: sampled(lag).position, acceleration: sampled(0).acceleration, duration: total };
}

// The sampled loop on the model under a reference: position and force. `feedforward` is a mass on the acceleration; the
// controller runs on the error, and its observer on the force beside what is fed forward, as in the C of `design`.
export function simulate(loop, sections, reference, { acceleration = null, feedforward = 0, limit = Infinity } = {}) {
  const { machine, sampleTime, delay, observer } = loop, model = machine.model;
  const [whole, late] = splitDelay(delay / sampleTime), count = reference.length, modes = model.omega.length;
  const chains = model.omega.map((w, k) => lateMode(w, model.damping[k], sampleTime, late, model.drag));
  const x = new Float64Array(2 * modes), rows = biquadsOf(sections, sampleTime);
  const memory = rows.map(() => [0, 0]);
  const position = new Float64Array(count), force = new Float64Array(count);
  const known = (k) => (acceleration && k >= 0 ? feedforward * acceleration[k] : 0);
  const n = observer ? observer.a.rows : 0;
  let state = new Float64Array(n), next = new Float64Array(n);
  const filters = observer ? observer.filters.map(() => [0, 0]) : [];
  for (let k = 0; k < count; k++) {
    const acting = k - whole >= 0 ? k - whole : -1; // whose force begins in this sample
    const before = acting >= 1 ? force[acting - 1] : 0; // what acted until now
    let y = model.feedthrough * before;
    for (let i = 0; i < modes; i++) y += model.output[i] * x[2 * i];
    position[k] = y;
    const seen = y - reference[k];
    let flexible = 0, damped = 0;
    const velocities = [];
    if (observer) {
      for (let r = 0; r < observer.c.rows; r++) {
        let sum = observer.d[r] * seen;
        for (let i = 0; i < n; i++) sum += observer.c.at[r * n + i] * state[i];
        if (r === 0) flexible = sum;
        else velocities.push(sum);
      }
      observer.filters.forEach((filter, i) => (damped += filter.gain * filters[i][1]));
    }
    let value = flexible - seen;
    rows.forEach(([b0, b1, b2, , a1, a2], i) => {
      const out = b0 * value + memory[i][0];
      memory[i][0] = b1 * value - a1 * out + memory[i][1];
      memory[i][1] = b2 * value - a2 * out;
      value = out;
    });
    value += damped + known(k);
    force[k] = Math.min(Math.max(value, -limit), limit);
    const now = acting >= 0 ? force[acting] : 0, beside = now - known(acting);
    for (let i = 0; i < modes; i++) {
      const [p11, p12, p21, p22, g1, g2, o1, o2] = chains[i], a = x[2 * i], b = x[2 * i + 1], drive = model.input[i];
      x[2 * i] = p11 * a + p12 * b + drive * (g1 * now + o1 * before);
      x[2 * i + 1] = p21 * a + p22 * b + drive * (g2 * now + o2 * before);
    }
    if (observer) {
      for (let i = 0; i < n; i++) {
        let sum = observer.b.at[2 * i] * beside + observer.b.at[2 * i + 1] * seen;
        for (let m = 0; m < n; m++) sum += observer.a.at[i * n + m] * state[m];
        next[i] = sum;
      }
      [state, next] = [next, state];
      observer.filters.forEach(({ held: [p11, p12, p21, p22, g1, g2] }, i) => {
        const [a, b] = filters[i];
        filters[i] = [p11 * a + p12 * b + g1 * velocities[i], p21 * a + p22 * b + g2 * velocities[i]];
      });
    }
  }
  return { position, force };
}
