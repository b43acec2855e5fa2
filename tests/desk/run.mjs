// Runs a list of calls of the desk's modules: [{module, name, arguments}] on the input, their results on the output.
// The module "here" is what stands below: several calls that hand objects to each other.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const folder = process.argv[2];
const load = (name) => import(pathToFileURL(`${folder}/${name}`));
const [L, R, M, O, S, X, B, F] = await Promise.all(
  ["loop.js", "response.js", "model.js", "observer.js", "simulate.js", "optimise.js", "export.js", "files.js"].map(load),
);

const here = {
  // Every response of a design on given frequencies (rad/s), and what is judged on the desk's own grid.
  responses(machine, design, frequencies) {
    const omega = Float64Array.from(frequencies), { sampleTime, delay, observer } = R.timing(design);
    const plant = M.plantResponse(machine.model, omega, sampleTime, delay);
    const own = observer && O.makeObserver(machine.model, machine.mass, observer, sampleTime, delay);
    const seen = { omega, plant, observer: own && O.observerResponse(own, omega) };
    const controller = R.controllerResponse(design, omega);
    const judged = L.judge(L.makeLoop(machine, design), design);
    return { plant, controller, functions: L.loopFunctions(seen, controller, true), unstable: judged.unstable, bandwidth: judged.bandwidth };
  },
  chain(design, frequencies) {
    const omega = Float64Array.from(frequencies), { sampleTime } = R.timing(design);
    const sections = sampleTime ? R.biquads(design) : [];
    return { response: R.controllerResponse(design, omega), biquads: sections, sampled: sampleTime ? R.biquadsResponse(sections, omega, sampleTime) : null };
  },
  box(machine, design, frequencies) {
    const loop = L.makeLoop(machine, design), box = L.makeBox(loop, Float64Array.from(frequencies));
    const search = L.boxSearch(loop, R.controllerSections(design, loop.sampleTime), { box });
    search.step();
    return search.results();
  },
  measured(machine, design) {
    const loop = L.makeLoop(machine, design), judged = L.judge(loop, design);
    return { omega: loop.measured.omega, plant: loop.measured.plant, turns: judged.extraTurns, functions: judged.measured };
  },
  step(machine, design, count) {
    const loop = L.makeLoop(machine, design);
    return S.simulate(loop, R.controllerSections(design, loop.sampleTime), new Float64Array(count).fill(1));
  },
  scan(machine, design, path, acceleration) {
    const loop = L.makeLoop(machine, design), sections = R.controllerSections(design, loop.sampleTime);
    return S.simulate(loop, sections, Float64Array.from(path), { acceleration: Float64Array.from(acceleration), feedforward: machine.mass });
  },
  best(machine, design, seconds) {
    const search = X.makeSearch(machine, design, { seconds });
    while (!search.step(1000));
    const found = search.results(), loop = L.makeLoop(machine, found.design);
    return { ...found, bandwidth: L.judge(loop, found.design).bandwidth };
  },
  alone(machine, design) {
    const found = F.measuredAlone(machine), judged = L.judge(L.makeLoop(found, design), design);
    return { rigid: found.rigid, turned: found.turned, mass: found.mass, unstable: judged.unstable, box: judged.box.unstable };
  },
  // The first design of a machine, and of a measurement alone however it is taken below its first line.
  first(machine, below = null) {
    const found = machine.model ? machine : F.measuredAlone(machine, below), { design, words } = X.stableFirstDesign(found);
    const judged = L.judge(L.makeLoop(found, design), design);
    return { design, words, stable: judged.stable, rigid: found.rigid, peak: (judged.box ?? judged.nominal).output_sensitivity.size };
  },
  controller: B.controllerJson,
};

const plain = (value) =>
  ArrayBuffer.isView(value)
    ? [...value]
    : Array.isArray(value)
      ? value.map(plain)
      : value && typeof value === "object"
        ? Object.fromEntries(Object.entries(value).map(([name, each]) => [name, plain(each)]))
        : value;

const results = [];
for (const { module, name, arguments: given } of JSON.parse(readFileSync(0, "utf8"))) {
  const loaded = module === "here" ? here : await load(module);
  try {
    results.push({ value: plain(loaded[name](...given)) });
  } catch (error) {
    results.push({ error: error.message });
  }
}
process.stdout.write(JSON.stringify(results));
