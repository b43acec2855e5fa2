// Runs a list of calls of the desk's modules: [{module, name, arguments}] on the input, their results on the output.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const folder = process.argv[2];
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
  const loaded = await import(pathToFileURL(`${folder}/${module}`));
  try {
    results.push({ value: plain(await loaded[name](...given)) });
  } catch (error) {
    results.push({ error: error.message });
  }
}
process.stdout.write(JSON.stringify(results));
