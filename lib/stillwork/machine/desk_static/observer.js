// An observer of the flexible modes: its Riccati equation by doubling, and MC and AD as four responses.
import { complexArray } from "./complex.js";
import { heldMode, lateMode, splitDelay } from "./model.js";

// --- matrices of doubles: {rows, cols, at} by rows ---

export const zeros = (rows, cols) => ({ rows, cols, at: new Float64Array(rows * cols) });
export function fromRows(rows) {
  return { rows: rows.length, cols: rows[0].length, at: Float64Array.from(rows.flat()) };
}
export function identity(n) {
  const eye = zeros(n, n);
  for (let k = 0; k < n; k++) eye.at[k * n + k] = 1;
  return eye;
}
export function product(a, b) {
  const c = zeros(a.rows, b.cols);
  for (let i = 0; i < a.rows; i++) {
    for (let k = 0; k < a.cols; k++) {
      const x = a.at[i * a.cols + k];
      if (x === 0) continue;
      for (let j = 0; j < b.cols; j++) c.at[i * b.cols + j] += x * b.at[k * b.cols + j];
    }
  }
  return c;
}
export function transposed(a) {
  const t = zeros(a.cols, a.rows);
  for (let i = 0; i < a.rows; i++) for (let j = 0; j < a.cols; j++) t.at[j * a.rows + i] = a.at[i * a.cols + j];
  return t;
}
export function plus(a, b, factor = 1) {
  const sum = zeros(a.rows, a.cols);
  for (let k = 0; k < sum.at.length; k++) sum.at[k] = a.at[k] + factor * b.at[k];
  return sum;
}
function symmetric(a) {
  return plus(a, transposed(a)).at.map((x) => x / 2);
}
export function solve(a, b) {
  const n = a.rows, m = b.cols, l = Float64Array.from(a.at), x = { rows: n, cols: m, at: Float64Array.from(b.at) };
  for (let k = 0; k < n; k++) {
    let pivot = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(l[i * n + k]) > Math.abs(l[pivot * n + k])) pivot = i;
    if (!(Math.abs(l[pivot * n + k]) > 0)) throw new Error("the observer's equations are singular");
    if (pivot !== k) {
      for (let j = 0; j < n; j++) [l[k * n + j], l[pivot * n + j]] = [l[pivot * n + j], l[k * n + j]];
      for (let j = 0; j < m; j++) [x.at[k * m + j], x.at[pivot * m + j]] = [x.at[pivot * m + j], x.at[k * m + j]];
    }
    for (let i = k + 1; i < n; i++) {
      const factor = l[i * n + k] / l[k * n + k];
      if (factor === 0) continue;
      for (let j = k + 1; j < n; j++) l[i * n + j] -= factor * l[k * n + j];
      for (let j = 0; j < m; j++) x.at[i * m + j] -= factor * x.at[k * m + j];
    }
  }
  for (let i = n - 1; i >= 0; i--) {
    for (let j = 0; j < m; j++) {
      let sum = x.at[i * m + j];
      for (let k = i + 1; k < n; k++) sum -= l[i * n + k] * x.at[k * m + j];
      x.at[i * m + j] = sum / l[i * n + i];
    }
  }
  return x;
}

// Limit from zero of P <- F'P(I + GP)^-1 F + H, 2^k of its steps at a time (Chu, Fan, Lin and Wang, 2004).
export function doubled(transition, gram, noise) {
  const n = noise.rows, eye = identity(n);
  let f = transition, g = gram, p = noise;
  for (let round = 0; round < 60; round++) {
    const both = zeros(n, 2 * n);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j < n; j++) {
        both.at[i * 2 * n + j] = f.at[i * n + j];
        both.at[i * 2 * n + n + j] = g.at[i * n + j];
      }
    }
    const solved = solve(plus(eye, product(g, p)), both), left = zeros(n, n), right = zeros(n, n);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j < n; j++) {
        left.at[i * n + j] = solved.at[i * 2 * n + j];
        right.at[i * n + j] = solved.at[i * 2 * n + n + j];
      }
    }
    const added = product(product(transposed(f), p), left);
    added.at = symmetric(added);
    g = plus(g, product(product(f, right), transposed(f)));
    g.at = symmetric(g);
    f = product(f, left);
    p = plus(p, added);
    let most = 0, size = 0;
    for (let k = 0; k < n * n; k++) {
      most = Math.max(most, Math.abs(added.at[k]));
      size = Math.max(size, Math.abs(p.at[k]));
    }
    if (!Number.isFinite(size)) throw new Error("the observer's Riccati equation has no finite solution");
    if (most <= 2.3e-16 * size) break;
  }
  return p;
}

// Filter gain K of x+ = Ax + Gw, y = Cx + v with unit noises in G and C, by states of their own deviation.
export function filterGain(a, g, c, firstScale) {
  let scale = firstScale, gain = null, covariance = null;
  const n = a.rows;
  for (let round = 0; round < 3; round++) {
    const as = zeros(n, n), gs = zeros(n, g.cols), cs = zeros(1, n);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j < n; j++) as.at[i * n + j] = (a.at[i * n + j] * scale[j]) / scale[i];
      for (let j = 0; j < g.cols; j++) gs.at[i * g.cols + j] = g.at[i * g.cols + j] / scale[i];
      cs.at[i] = c.at[i] * scale[i];
    }
    // Divide noise and multiply output alike: the gain stays, the covariance becomes of order one.
    const size = Math.sqrt(Math.hypot(...gs.at) / Math.hypot(...cs.at));
    gs.at = gs.at.map((x) => x / size);
    cs.at = cs.at.map((x) => x * size);
    const p = doubled(transposed(as), product(transposed(cs), cs), product(gs, transposed(gs)));
    const seen = product(p, transposed(cs)); // P C'
    const innovation = product(cs, seen).at[0] + 1;
    gain = seen.at.map((x, k) => (scale[k] * x * size) / innovation);
    covariance = p.at.map((x, k) => x * size * size * scale[Math.floor(k / n)] * scale[k % n]);
    scale = Float64Array.from({ length: n }, (_, k) => Math.sqrt(Math.max(covariance[k * n + k], 1e-300)));
  }
  return { gain, covariance, scale };
}

// The machine as the observer has it: its first modes, the compliance of the others as feedthrough.
export function reduced(model, retained) {
  const count = Math.min(retained, model.omega.length), cut = (values) => values.slice(0, count);
  let feedthrough = model.feedthrough;
  for (let k = count; k < model.omega.length; k++) {
    feedthrough += (model.input[k] * model.output[k]) / model.omega[k] ** 2;
  }
  const kept = {
    omega: cut(model.omega), damping: cut(model.damping), input: cut(model.input), output: cut(model.output),
    feedthrough, drag: model.drag,
  };
  // A suspension counts as the rigid body.
  if (kept.omega[0] > 0) {
    kept.omega = [0, ...kept.omega.slice(1)];
    kept.damping = [0, ...kept.damping.slice(1)];
  }
  return kept;
}

// The observer's estimator from (u, y), u the force that acts, to the flexible part of y and the modal velocities:
// x+ = a x + b (u, y), (y_flex, velocities) = c x + d y. `mass` turns accelerations into forces.
export function makeObserver(model, mass, block, sampleTime, delay) {
  const kept = reduced(model, block.retained), modes = kept.omega.length, states = 2 * modes;
  const [whole, late] = splitDelay(delay / sampleTime);
  const walk = block.compensate, n = states + (walk ? 1 : 0);
  const a = zeros(n, n), c = zeros(1, n), b = new Float64Array(n), before = new Float64Array(n);
  const g = zeros(n, walk ? 2 : 1);
  const process = Math.sqrt((block.disturbance * mass) ** 2 / sampleTime);
  const scale = new Float64Array(n);
  for (let k = 0; k < modes; k++) {
    const w = kept.omega[k], z = kept.damping[k], i = 2 * k, drive = kept.input[k];
    const held = heldMode(w, z, sampleTime, kept.drag), own = lateMode(w, z, sampleTime, late, kept.drag);
    [a.at[i * n + i], a.at[i * n + i + 1], a.at[(i + 1) * n + i], a.at[(i + 1) * n + i + 1]] = held;
    for (const row of [0, 1]) {
      b[i + row] = own[4 + row] * drive;
      before[i + row] = own[6 + row] * drive;
      g.at[(i + row) * g.cols] = held[4 + row] * drive * process;
      if (walk) a.at[(i + row) * n + states] = held[4 + row] * drive;
    }
    c.at[i] = kept.output[k];
    scale[i] = 1 / Math.max(w, 1);
    scale[i + 1] = 1;
  }
  if (walk) {
    a.at[n * n - 1] = 1;
    g.at[states * 2 + 1] = Math.sqrt(block.drift * mass * mass * sampleTime);
    scale[states] = 1 / Math.max(Math.abs(kept.input[0]), 1e-12);
  }
  const noise = Math.sqrt((block.sensor * block.sensor) / sampleTime);
  const root = { rows: 1, cols: n, at: c.at.map((x) => x / noise) };
  const found = filterGain(a, g, root, scale);
  const gain = { rows: n, cols: 1, at: found.gain.map((x) => x / noise) };
  const past = { rows: 1, cols: n, at: c.at };
  const kc = product(gain, past), corrected = plus(identity(n), kc, -1); // I - KC
  const ak = product(a, gain), inner = product(a, corrected), size = n + 1, d = kept.feedthrough;
  const estimator = zeros(size, size), into = zeros(size, 2);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) estimator.at[i * size + j] = inner.at[i * n + j];
    estimator.at[i * size + n] = before[i] - ak.at[i] * d;
    into.at[i * 2] = b[i];
    into.at[i * 2 + 1] = ak.at[i];
  }
  into.at[n * 2] = 1;
  const rows = [new Float64Array(n)];
  for (let k = 1; k < modes; k++) {
    if (block.compensate) rows[0][2 * k] = kept.output[k];
    const velocity = new Float64Array(n);
    velocity[2 * k + 1] = 1;
    rows.push(velocity);
  }
  const out = zeros(rows.length, size), direct = new Float64Array(rows.length);
  rows.forEach((row, r) => {
    const read = product({ rows: 1, cols: n, at: row }, corrected);
    out.at.set(read.at, r * size);
    direct[r] = row.reduce((sum, x, k) => sum + x * gain.at[k], 0);
    out.at[r * size + n] = -direct[r] * d;
  });
  // Active damping: each velocity through its sampled band-pass and gain.
  const filters = [];
  for (let k = 1; k < modes && block.damping > 0; k++) {
    const w = kept.omega[k], quality = block.selectivity;
    const held = heldMode(w, 1 / (2 * quality), sampleTime);
    held[4] *= w / quality;
    held[5] *= w / quality;
    filters.push({ held, gain: (-2 * block.damping * w) / kept.input[k] });
  }
  return { a: estimator, b: into, c: out, d: direct, filters, whole, late, sampleTime, scale: [...found.scale, 0] };
}

// Hessenberg form of the scaled estimator: a = Q H Q'.
function hessenberg(observer) {
  const n = observer.a.rows, h = zeros(n, n), scale = Float64Array.from(observer.scale);
  // The last state, the force before, counts as what drives the others with its size.
  let most = 0;
  for (let i = 0; i < n - 1; i++) most = Math.max(most, Math.abs(observer.b.at[2 * i] / scale[i]));
  scale[n - 1] = 1 / (most || 1);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) h.at[i * n + j] = (observer.a.at[i * n + j] * scale[j]) / scale[i];
  }
  const b = zeros(n, 2), c = zeros(observer.c.rows, n);
  for (let i = 0; i < n; i++) {
    for (const j of [0, 1]) b.at[2 * i + j] = observer.b.at[2 * i + j] / scale[i];
    for (let r = 0; r < c.rows; r++) c.at[r * n + i] = observer.c.at[r * n + i] * scale[i];
  }
  for (let k = 0; k < n - 2; k++) {
    const v = new Float64Array(n);
    let size = 0;
    for (let i = k + 1; i < n; i++) size += h.at[i * n + k] ** 2;
    size = Math.sqrt(size);
    if (size === 0) continue;
    for (let i = k + 1; i < n; i++) v[i] = h.at[i * n + k];
    v[k + 1] += v[k + 1] < 0 ? -size : size;
    let norm = 0;
    for (let i = k + 1; i < n; i++) norm += v[i] * v[i];
    const fromLeft = (m, cols) => {
      for (let j = 0; j < cols; j++) {
        let sum = 0;
        for (let i = k + 1; i < n; i++) sum += v[i] * m[i * cols + j];
        sum *= 2 / norm;
        for (let i = k + 1; i < n; i++) m[i * cols + j] -= sum * v[i];
      }
    };
    const fromRight = (m, rows) => {
      for (let i = 0; i < rows; i++) {
        let sum = 0;
        for (let j = k + 1; j < n; j++) sum += m[i * n + j] * v[j];
        sum *= 2 / norm;
        for (let j = k + 1; j < n; j++) m[i * n + j] -= sum * v[j];
      }
    };
    fromLeft(h.at, n);
    fromRight(h.at, n);
    fromLeft(b.at, 2);
    fromRight(c.at, c.rows);
  }
  return { h, b, c };
}

// The four responses (u, y) to (u_d, y_flex) on a grid, u before its delay.
export function observerResponse(observer, omega) {
  const { h, b, c } = (observer.hessenberg ??= hessenberg(observer));
  const n = h.rows, count = c.rows, time = observer.sampleTime;
  const found = { uu: null, uy: null, yu: null, yy: null };
  for (const name in found) found[name] = complexArray(omega.length);
  const mr = new Float64Array(n * n), mi = new Float64Array(n * n);
  const xr = new Float64Array(2 * n), xi = new Float64Array(2 * n);
  for (let f = 0; f < omega.length; f++) {
    const t = omega[f] * time, half = Math.sin(t / 2), lr = -2 * half * half, zi = Math.sin(t);
    for (let k = 0; k < n * n; k++) mr[k] = -h.at[k];
    mi.fill(0);
    for (let k = 0; k < n; k++) {
      mr[k * n + k] = lr + (1 - h.at[k * n + k]);
      mi[k * n + k] = zi;
    }
    xr.set(b.at);
    xi.fill(0);
    for (let k = 0; k < n - 1; k++) {
      const i = k + 1;
      const here = Math.abs(mr[k * n + k]) + Math.abs(mi[k * n + k]);
      if (Math.abs(mr[i * n + k]) + Math.abs(mi[i * n + k]) > here) {
        for (let j = k; j < n; j++) {
          let x = mr[k * n + j]; mr[k * n + j] = mr[i * n + j]; mr[i * n + j] = x;
          x = mi[k * n + j]; mi[k * n + j] = mi[i * n + j]; mi[i * n + j] = x;
        }
        for (let j = 0; j < 2; j++) {
          let x = xr[2 * k + j]; xr[2 * k + j] = xr[2 * i + j]; xr[2 * i + j] = x;
          x = xi[2 * k + j]; xi[2 * k + j] = xi[2 * i + j]; xi[2 * i + j] = x;
        }
      }
      const pr = mr[k * n + k], pi = mi[k * n + k], size = pr * pr + pi * pi;
      const ar = mr[i * n + k], ai = mi[i * n + k];
      if (ar === 0 && ai === 0) continue;
      const fr = (ar * pr + ai * pi) / size, fi = (ai * pr - ar * pi) / size;
      for (let j = k + 1; j < n; j++) {
        const ur = mr[k * n + j], ui = mi[k * n + j];
        mr[i * n + j] -= fr * ur - fi * ui;
        mi[i * n + j] -= fr * ui + fi * ur;
      }
      for (let j = 0; j < 2; j++) {
        const ur = xr[2 * k + j], ui = xi[2 * k + j];
        xr[2 * i + j] -= fr * ur - fi * ui;
        xi[2 * i + j] -= fr * ui + fi * ur;
      }
    }
    for (let i = n - 1; i >= 0; i--) {
      const pr = mr[i * n + i], pi = mi[i * n + i], size = pr * pr + pi * pi;
      for (let j = 0; j < 2; j++) {
        let sr = xr[2 * i + j], si = xi[2 * i + j];
        for (let k = i + 1; k < n; k++) {
          const ar = mr[i * n + k], ai = mi[i * n + k], ur = xr[2 * k + j], ui = xi[2 * k + j];
          sr -= ar * ur - ai * ui;
          si -= ar * ui + ai * ur;
        }
        xr[2 * i + j] = (sr * pr + si * pi) / size;
        xi[2 * i + j] = (si * pr - sr * pi) / size;
      }
    }
    const turn = -t * observer.whole, cosine = Math.cos(turn), sine = Math.sin(turn);
    for (let r = 0; r < count; r++) {
      let ur = 0, ui = 0, yr = observer.d[r], yi = 0;
      for (let k = 0; k < n; k++) {
        const w = c.at[r * n + k];
        ur += w * xr[2 * k];
        ui += w * xi[2 * k];
        yr += w * xr[2 * k + 1];
        yi += w * xi[2 * k + 1];
      }
      const vr = ur * cosine - ui * sine;
      ui = ur * sine + ui * cosine;
      ur = vr;
      if (r === 0) {
        found.yu.re[f] = ur; found.yu.im[f] = ui;
        found.yy.re[f] = yr; found.yy.im[f] = yi;
        continue;
      }
      const filter = observer.filters[r - 1];
      if (!filter) continue;
      // Velocity of the held band-pass: ((z - p11) g2 + p21 g1) / determinant.
      const [p11, p12, p21, p22, g1, g2] = filter.held, q11 = p11 - 1, q22 = p22 - 1;
      const dr = lr * lr - zi * zi - lr * (q11 + q22) + q11 * q22 - p12 * p21, di = 2 * lr * zi - zi * (q11 + q22);
      const nr = (lr - q11) * g2 + p21 * g1, ni = zi * g2, size = dr * dr + di * di;
      const br = (filter.gain * (nr * dr + ni * di)) / size, bi = (filter.gain * (ni * dr - nr * di)) / size;
      found.uu.re[f] += br * ur - bi * ui; found.uu.im[f] += br * ui + bi * ur;
      found.uy.re[f] += br * yr - bi * yi; found.uy.im[f] += br * yi + bi * yr;
    }
  }
  return found;
}
