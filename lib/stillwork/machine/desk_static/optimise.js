// "Best for this structure": a local search over the free numbers for the largest bandwidth under 6 dB.
import { ALLOWED_DB, FUNCTIONS, addPlace, boxSearch, judge, makeLoop } from "./loop.js";
import { toDb } from "./complex.js";
import { BLOCKS, controllerSections, isFilter } from "./response.js";
import { firstDesign } from "./state.js";

const LIMIT_DB = 6; // sought; what is handed out keeps ALLOWED_DB
const PRICE = 0.7; // octaves of bandwidth that a dB above the limit costs: more than a dB ever gains
// Factors by which an observer's numbers are tried one by one: a simplex is too small for what counts in powers of ten.
const LOOK = { damping: 2, selectivity: 2, sensor: 10, drift: 10 };
const SLOWEST = 15; // bandwidth over the lowest integrator: a search would leave the integrator out

// Numbers of a design that a search may change: {block, name, low, high}; those that the user holds fixed stay.
export function freeNumbers(design) {
  const found = [];
  design.blocks.forEach((block, index) => {
    if (block.off) return;
    for (const [name, about] of Object.entries(BLOCKS[block.kind].numbers)) {
      const held = (block.fixed ?? []).includes(name);
      const unused = block.kind === "observer" && (name === "selectivity" || name === "damping") && !(block.damping > 0);
      const idle = block.kind === "observer" && name === "drift" && !block.compensate;
      if (about.free && !held && !unused && !idle && block[name] > 0) found.push({ index, name, low: about.low, high: about.high });
    }
  });
  return found;
}

export const withNumbers = (design, numbers, logarithms) => {
  const blocks = design.blocks.map((block) => ({ ...block }));
  numbers.forEach(({ index, name, low, high }, k) => {
    blocks[index][name] = Math.min(Math.max(Math.exp(logarithms[k]), low), high);
  });
  return { ...design, blocks };
};

// Octaves of bandwidth less the price of what is above the limit; below -1000 where the loop is unstable.
export function merit(result, design, limit = LIMIT_DB) {
  if (!result.stable) return -2000 - 10 * (result.unstable + (result.box ? result.box.unstable : 0));
  if (!(result.bandwidth > 0)) return -3000;
  let excess = 0;
  for (const name of FUNCTIONS) {
    for (const each of [result.nominal[name], result.box && result.box[name]]) {
      if (each) excess = Math.max(excess, toDb(each.size) - limit);
    }
  }
  let slow = 0;
  for (const block of design.blocks) {
    const corner = block.off ? 0 : block.kind === "pid" ? block.integrator_hz : block.kind === "integrator" ? block.zero_hz : 0;
    if (corner) slow = Math.max(slow, Math.log2(result.bandwidth / (SLOWEST * corner)));
  }
  return Math.log2(result.bandwidth) - PRICE * excess - 4 * Math.max(slow, 0);
}

// Bandwidths of a first design over the rule's own, in the order in which they are tried.
const FIRST_FACTORS = [1, 1 / 2, 1 / 4, 1 / 8, 2, 4, 8, 16, 1 / 16, 1 / 32, 1 / 64, 1 / 128];
const NEXT_TO_NOTHING = 1e-9; // of its gain, where none of these is stable

// A first design that is stable, all over the box: the first of the factors that keeps 6 dB there, else the first stable
// one; and what to say of it.
export function stableFirstDesign(machine) {
  const first = firstDesign(machine), loop = makeLoop(machine, first);
  const moved = (factor, gain = factor * factor) => ({
    ...first,
    blocks: first.blocks.map((block) => {
      if (block.kind !== "pid") return block;
      const numbers = { ...block, gain: block.gain * gain };
      for (const name of ["integrator_hz", "differentiator_hz", "low_pass_hz"]) numbers[name] *= factor;
      return numbers;
    }),
  });
  let stable = null;
  for (const factor of FIRST_FACTORS) {
    const design = moved(factor), result = judge(loop, design, { whole: false });
    if (!result.stable) continue;
    const peak = Math.max(...FUNCTIONS.map((name) => (result.box ?? result.nominal)[name].size));
    if (toDb(peak) <= ALLOWED_DB) return { design, words: [] };
    stable ??= design;
  }
  if (stable) return { design: stable, words: [] };
  return { design: moved(1, NEXT_TO_NOTHING), words: ["no stable one was found: it begins with next to no gain"] };
}

// A search in slices: `step(ms)` until it returns true; then `results()`. The loop is looked at on thinned grids while
// numbers move, and the whole box is searched between the rounds.
export function makeSearch(machine, design, { seconds = 6 } = {}) {
  const numbers = freeNumbers(design);
  if (!numbers.length) throw new Error("every number is held fixed; release one");
  const observing = numbers.some(({ index }) => !isFilter(design.blocks[index]));
  let loop = makeLoop(machine, design, { points: 140, around: 10 });
  const places = [];
  const observerOf = (trial) => JSON.stringify(trial.blocks.filter((block) => !isFilter(block)));
  let built = observerOf(design);
  // An observer is made anew only where its own numbers moved.
  const rebuild = (trial) => {
    const wanted = observerOf(trial);
    if (wanted === built) return loop;
    built = wanted;
    loop = makeLoop(machine, trial, { points: 140, around: 10 });
    places.forEach((place) => addPlace(loop, place));
    return loop;
  };
  let evaluations = 0, limit = LIMIT_DB;
  const score = (logarithms) => {
    evaluations++;
    const trial = withNumbers(design, numbers, logarithms);
    try {
      return merit(judge(observing ? rebuild(trial) : loop, trial, { whole: false }), trial, limit);
    } catch {
      return -4000;
    }
  };
  const first = numbers.map(({ index, name }) => Math.log(design.blocks[index][name]));
  let best = { at: first, score: score(first) };
  const take = (at) => {
    const value = score(at);
    if (value > best.score) best = { at, score: value };
    return value;
  };
  let holds = false;
  const keepPlace = (place) => {
    places.push(place);
    if (loop.model) addPlace(loop, place);
  };
  const began = performance.now(), budget = 1000 * seconds;
  const filters = numbers.some(({ index }) => isFilter(design.blocks[index]));
  const rounds = machine.model && filters ? 4 : 1;
  const worker = (function* () {
    const parts = numbers.map(({ index, name }) => ({
      // How a number follows when the whole controller is moved by a factor in frequency.
      hertz: name.endsWith("_hz") && !["notch"].includes(design.blocks[index].kind) ? 1 : 0,
      gain: name === "gain" || name === "value",
    }));
    const gains = parts.filter((each) => each.gain).length;
    const moved = (at, octaves) =>
      at.map((x, k) => x + Math.LN2 * octaves * (parts[k].hertz + (parts[k].gain ? 2 / gains : 0)));
    const slide = function* () {
      // The whole controller in frequency, then its gain alone.
      for (const octaves of [2, 1, 0.5, -0.5, -1, -2, -4, 0.25, -0.25, 0.1, -0.1, 0.05, -0.05]) {
        for (let k = 0; k < 6; k++) {
          const before = best.score;
          take(moved(best.at, octaves));
          yield;
          if (!(best.score > before)) break;
        }
      }
    };
    // One number of the observer after the other, the bandwidth pushed up after each step, as `design` does.
    const look = function* () {
      for (let k = 0; k < numbers.length; k++) {
        if (isFilter(design.blocks[numbers[k].index]) || !LOOK[numbers[k].name]) continue;
        for (const factor of [LOOK[numbers[k].name], 1 / LOOK[numbers[k].name]]) {
          for (let more = 0; more < 8; more++) {
            const before = best.score, base = best.at.map((x, j) => (j === k ? x + Math.log(factor) : x));
            for (const octaves of [0, 0.06, 0.25]) {
              take(moved(base, octaves));
              yield;
            }
            if (!(best.score > before)) break;
          }
        }
      }
    };
    for (let round = 0; round < rounds; round++) {
      yield* slide();
      if (observing) yield* look();
      const share = began + (budget * (round + 1)) / rounds;
      let size = round ? 0.12 : 0.3;
      while (performance.now() < share && size > 4e-3) {
        const before = best.score;
        // The filters alone at first: with them an observer need not be made anew.
        const chosen = numbers.map((_, k) => k).filter((k) => round === rounds - 1 || isFilter(design.blocks[numbers[k].index]));
        const all = best.at, whole = (part) => all.map((x, k) => (chosen.includes(k) ? part[chosen.indexOf(k)] : x));
        yield* nelderMead(chosen.map((k) => all[k]), size, (part) => take(whole(part)), () => performance.now() > share);
        if (best.score < before + 0.01) size /= 3;
      }
      yield* slide();
      if (!loop.model || !loop.corners.length) continue;
      // The whole box at the best: places that do harm are looked at from now on.
      const trial = withNumbers(design, numbers, best.at), here = observing ? rebuild(trial) : loop;
      const search = boxSearch(here, controllerSections(trial, here.sampleTime), { least: 10 ** ((LIMIT_DB + 0.003) / 20) });
      while (!search.step(10)) yield;
      let harm = 0;
      for (const each of Object.values(search.results())) {
        if (each.place) {
          keepPlace(each.place);
          harm++;
        }
      }
      if (!harm && round && !observing) break;
      best.score = score(best.at);
      yield;
    }
    // On the full grid and in the whole box: where it still exceeds, the search goes on below a lower limit.
    for (let k = 0; k < 6; k++) {
      const excess = yield* excessOf(machine, withNumbers(design, numbers, best.at), keepPlace);
      if (excess <= 0) {
        holds = true;
        return;
      }
      if (!Number.isFinite(excess)) break;
      limit -= excess + 0.01;
      best.score = score(best.at);
      const until = performance.now() + budget / 6;
      yield* nelderMead(best.at, 0.05, take, () => performance.now() > until);
    }
    // What is left is to be slower, by as little as will do.
    const slower = (octaves) => moved(best.at, -octaves);
    const fails = function* (octaves) {
      return (yield* excessOf(machine, withNumbers(design, numbers, slower(octaves)), () => {})) > 0;
    };
    let near = 0, far = 0.02;
    while (far < 6 && (yield* fails(far))) [near, far] = [far, 1.5 * far];
    if (far >= 6) return;
    for (let k = 0; k < 4; k++) {
      const middle = (near + far) / 2;
      if (yield* fails(middle)) near = middle;
      else far = middle;
    }
    best = { at: slower(far), score: best.score };
    holds = true;
  })();
  let done = false;
  return {
    step(milliseconds) {
      const until = performance.now() + milliseconds;
      while (!done && performance.now() < until) done = worker.next().done;
      return done;
    },
    progress: () => Math.min((performance.now() - began) / budget, 1),
    results: () => ({ design: withNumbers(design, numbers, best.at), holds, evaluations, seconds: (performance.now() - began) / 1000 }),
  };
}

// dB above what is allowed on the full grid and in the whole box; infinite where the loop is not stable.
function* excessOf(machine, design, harmful) {
  let loop, result;
  try {
    loop = makeLoop(machine, design);
    result = judge(loop, design);
  } catch {
    return Infinity;
  }
  yield;
  if (!result.stable) return Infinity;
  let most = Math.max(...FUNCTIONS.flatMap((name) => [result.nominal[name].size, result.box ? result.box[name].size : 0]));
  if (loop.model && loop.corners.length) {
    const search = boxSearch(loop, result.sections, { least: Math.max(most, 10 ** (ALLOWED_DB / 20)) });
    while (!search.step(10)) yield;
    for (const each of Object.values(search.results())) {
      if (!each.place) continue;
      harmful(each.place);
      most = Math.max(most, each.size);
    }
  }
  return toDb(most) - ALLOWED_DB;
}

// Nelder and Mead's simplex in logarithms, a generator that stops between any two values.
export function* nelderMead(start, size, value, late) {
  const n = start.length, points = [];
  const add = (at) => ({ at, score: value(at) });
  points.push(add(start));
  yield;
  for (let k = 0; k < n; k++) {
    const at = [...start];
    at[k] += size * (k % 2 ? -1 : 1);
    points.push(add(at));
    yield;
  }
  for (let round = 0; round < 60 * n && !late(); round++) {
    points.sort((a, b) => b.score - a.score);
    if (points[0].score - points[n].score < 1e-4) return;
    const middle = start.map((_, k) => points.slice(0, n).reduce((sum, each) => sum + each.at[k], 0) / n);
    const toward = (factor) => middle.map((x, k) => x + factor * (points[n].at[k] - x));
    const mirrored = add(toward(-1));
    yield;
    if (mirrored.score > points[0].score) {
      const far = add(toward(-2));
      yield;
      points[n] = far.score > mirrored.score ? far : mirrored;
    } else if (mirrored.score > points[n - 1].score) points[n] = mirrored;
    else {
      const near = add(toward(mirrored.score > points[n].score ? -0.5 : 0.5));
      yield;
      if (near.score > Math.max(points[n].score, mirrored.score)) points[n] = near;
      else {
        for (let k = 1; k <= n; k++) {
          points[k] = add(points[k].at.map((x, j) => (x + points[0].at[j]) / 2));
          yield;
        }
      }
    }
  }
}
