// Names of columns: what each holds, and in which unit; as stillwork.signals.headings reads them, from the same table.

import { TABLE } from "./units.js";

const compiled = (pairs, flags) => pairs.map(([pattern, other]) => [new RegExp(pattern, flags), other]);
const WORDS = compiled(TABLE.words, "gi"), SYMBOLS = compiled(TABLE.symbols, "g");
const ROOT = new RegExp(TABLE.root, "gi"), DECIBELS = new RegExp(`^(?:${TABLE.decibels})$`, "i");
const DENSITIES = TABLE.densities.map(([pattern, power]) => [new RegExp(`^(?:${pattern})$`), power]);
const SPELLINGS = compiled(TABLE.spellings, "giu"), FOREIGN = new RegExp(`(?:^|[\\s_,;:/-])(${TABLE.foreign})$`, "i");
const ARGUMENT = new RegExp(`^(?:${TABLE.argument})$`), SCALED = new RegExp(TABLE.scaled);
const UNITS = new Map(Object.entries(TABLE.units)), FOLDED = new Map(Object.entries(TABLE.folded)), HOLDS = new Map(Object.entries(TABLE.holds));
const OF_WORD = new Map([...HOLDS].flatMap(([quantity, [words]]) => words.split(" ").map((word) => [word, quantity])));
export const POSITIONS = TABLE.positions;
export const DRIVES = TABLE.drives;
export const MOVES = TABLE.moves;

const ends = (text) => text.replace(/^[ ,;:/\-_]+|[ ,;:/\-_]+$/g, "");
const bare = (text) => text.replace(/^[() ]+|[() ]+$/g, "");
const wordsOf = (text) => text.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? [];
const bareWord = (word) => word.replace(/(?<=[^\d])\d+$/, "");
const letters = (text) => /\p{L}/u.test(text);

function spelled(text) {
  let plain = text.normalize("NFKC").trim();
  for (const [pattern, other] of [...WORDS, ...SYMBOLS]) plain = plain.replace(pattern, other);
  return plain;
}

function simple(plain) {
  if (UNITS.has(plain)) return UNITS.get(plain);
  if (/^(?:M[A-Za-z]|[GM]$)/.test(plain)) return null;
  return UNITS.get(FOLDED.get(plain.toLowerCase())) ?? null;
}

// Factor to SI and the unit there of a channel's unit; null for one that is not known.
export const unitFactor = (text) => simple(spelled(text));

function linear(text) {
  const plain = spelled(text), found = simple(plain), of = { lower: "", lowerSi: "", decibels: false, reference: 1, power: 0 };
  if (found) return { ...of, factor: found[0], si: found[1], upper: plain };
  if (plain === "1/kg") return { ...of, factor: 1, si: "m/s^2", upper: "m/s^2", lower: "N", lowerSi: "N" };
  const squeezed = plain.replaceAll(" ", "").replace(/hz$/i, "Hz");
  for (const [pattern, power] of DENSITIES) {
    const part = squeezed.match(pattern), motion = part && simple(spelled(bare(part[1])));
    if (motion) return { ...of, factor: motion[0], si: motion[1], upper: bare(part[1]), power };
  }
  const cut = plain.lastIndexOf("/");
  const [upper, lower] = [plain.slice(0, Math.max(cut, 0)), plain.slice(cut + 1)].map((each) => spelled(bare(each)));
  const above = simple(upper), below = simple(lower);
  if (!above || !below || !(DRIVES.includes(below[1]) || below[1] === above[1])) return null;
  return { ...of, factor: above[0] / below[0], si: above[1], upper, lower, lowerSi: below[1] };
}

// What a unit means, one of a density, a ratio or decibels too; null where it is not known.
export function meaning(text) {
  const plain = text.normalize("NFKC").trim().replace(ROOT, "rtHz"), found = plain.match(DECIBELS);
  if (!found) return linear(plain);
  let rest = found[2];
  if (rest.endsWith(")") && rest.split(")").length > rest.split("(").length) rest = rest.slice(0, -1);
  const unit = linear(rest.trim() || "1");
  return unit && !unit.power ? { ...unit, reference: Number(found[1] ?? 1), decibels: true } : null;
}

function brackets(text) {
  let rest = "", depth = 0, start = 0;
  const groups = [], all = [...text];
  all.forEach((letter, at) => {
    if ("([{".includes(letter)) {
      if (!depth) start = at + 1;
      depth++;
    } else if (")]}".includes(letter) && depth) {
      depth--;
      if (!depth) {
        groups.push(all.slice(start, at).join("").trim());
        rest += " ";
      }
    } else if (!depth) rest += letter;
  });
  return [depth ? `${rest} ${all.slice(start).join("")}` : rest, groups];
}

function atTheEnd(name) {
  let text = name.replace(/(?<=[\p{L}\p{N}_])\s+\d+$/u, "");
  text = text.replace(/_([munpk]?[mg])(_s2|_s)?_2_hz$/i, (_, motion, over) => `_(${motion}${over ?? ""})^2/Hz`);
  text = text.replace(/(?<=[\p{L}\p{N}_])(?=[%°])/gu, " ");
  const starts = [0, ...[...text.matchAll(new RegExp(TABLE.separators, "g"))].map((each) => each.index + each[0].length)];
  const camel = text.match(/(?<=[a-z])[A-Z][A-Za-z]*$/);
  for (const start of camel ? [...starts, camel.index] : starts) {
    const part = text.slice(start);
    if (!start && part.length === 1) continue;
    if (part.toLowerCase() === "in") break; // inches stand in brackets
    const flat = part.toLowerCase().startsWith("in_") ? part : part.replaceAll("_", "/");
    for (const each of [part, spelled(flat)]) {
      const unit = meaning(each);
      const before = text.slice(0, start).match(/([^ ]*) ?\/ ?$/);
      if (unit && before && UNITS.has(spelled(before[1]))) return [text, null]; // N/um is a stiffness, N s/m a damper
      if (unit) return [ends(`.${text.slice(0, start)}`).slice(1), [each, unit]];
    }
  }
  return [text, null];
}

function quantityOf(words) {
  let found = "";
  words.forEach((word, k) => {
    const plain = word.length > 2 ? bareWord(word) : word, quantity = OF_WORD.get(plain);
    if (!quantity || (plain.length === 1 && k)) return;
    const sampled = k && ["sample", "sampling"].includes(words[k - 1]);
    if (plain === "rate" && k && !sampled) return;
    if (["frequency", "time"].includes(quantity) && ["response", "resp", "responses"].includes(words[k + 1])) return;
    if (!TABLE.responses.includes(found) || !TABLE.of_a_response.includes(quantity)) found = sampled && quantity === "frequency" ? "rate" : quantity;
  });
  return found;
}

const fits = (quantity, unit) => HOLDS.get(quantity)[1].includes(unit.si);

function isStated([text, unit], quantity) {
  if (TABLE.responses.includes(quantity) && text.toLowerCase() === "h") return false; // no hours
  if (TABLE.strict.includes(quantity) || (quantity && fits(quantity, unit))) return true;
  return text.length > 1 && (unit.decibels || !["s", "Hz", "1"].includes(unit.si));
}

function alone([text, unit]) {
  if (unit.decibels) return "magnitude";
  return { Hz: "frequency", rad: "phase", s: text.length > 1 ? "time" : "" }[unit.si] ?? "";
}

function strangeOf(text, label, words, quantity, means) {
  if (/^-\s*\p{L}/u.test(text)) return "-";
  const turned = words.find((word) => TABLE.negated.includes(word));
  if (turned) return turned;
  if (SCALED.test(label)) return label;
  let last = words.findLastIndex((word) => OF_WORD.get(bareWord(word)) === quantity);
  if (last < 0) last = words.length;
  return (
    words.find((word, k) => {
      const plain = bareWord(word);
      if (TABLE.labels.includes(plain) || OF_WORD.has(plain) || /^\d+$/.test(plain)) return false;
      return (!means && k > last) || (word.length > 1 && meaning(word));
    }) ?? ""
  );
}

function plainOf(name) {
  let text = name.normalize("NFKC").trim().replace(ROOT, "rtHz");
  for (const [pattern, other] of SPELLINGS) text = text.replace(pattern, other);
  return text.replace(/^(?:[\p{L}_][\p{L}\p{N}_]*\.)+(?=[\p{L}_])/u, "");
}

// Those of the brackets that may hold a unit.
function ofUnits(groups, quantity) {
  if (TABLE.responses.includes(quantity)) groups = groups.filter((each) => !ARGUMENT.test(each.toLowerCase()));
  if (quantity && !HOLDS.get(quantity)[1].includes("1")) groups = groups.filter((each) => each !== "1");
  return groups;
}

// All units in the brackets and at the end of a name, and the one that counts.
function statedOf(groups, tail) {
  const stated = groups.map((each) => [each, meaning(each)]).filter(([, unit]) => unit), last = stated.at(-1);
  if (tail && last && tail[1].decibels && tail[1].si === "1" && !last[1].decibels) {
    return [stated, [`dB re 1 ${last[0]}`, { ...last[1], decibels: true }]];
  }
  if (tail) stated.push(tail);
  return [stated, stated.at(-1) ?? ["", null]];
}

function abscissa(words, means) {
  if (!means || !words.length || !words.every((each) => TABLE.axes.includes(each))) return "";
  return { s: "time", Hz: "frequency" }[means.si] ?? "";
}

// Whether a name says no more than that the others stand over its column: X-Axis.
export function isBareAbscissa(name) {
  const words = wordsOf(name);
  return words.every((each) => TABLE.axes.includes(each)) && words.some((each) => !["axis", "value"].includes(each));
}

function unlessAnother(quantity, label, odd, means) {
  let others = [label, ...odd].flatMap(wordsOf).map((each) => each.replace(/^\d+|\d+$/g, "")).filter((each) => TABLE.others.includes(each));
  if (quantity === "magnitude" && means?.decibels) others = others.filter((each) => !TABLE.logarithms.includes(each));
  if (others.some((each) => quantity !== "coherence" || each !== "squared")) return "";
  return quantity === "force" && means && means.si in MOVES && DRIVES.includes(means.lowerSi) ? "" : quantity;
}

function foreign(label) {
  const found = label.match(FOREIGN), ratio = label.match(/(?:^|[\s_,;:])([^\s_,;:/]+) ?\/ ?([^\s_,;:/]+)$/);
  if (found) return found[1];
  return ratio && UNITS.has(spelled(ratio[1])) && meaning(ratio[2]) ? ratio[0].trim() : "";
}

const same = (one, other) => ["factor", "si", "lowerSi", "decibels", "reference", "power"].every((key) => one[key] === other[key]);

// What the name of a column states: {quantity, unit, means, unknown, strange}.
export function heading(name) {
  const text = plainOf(name), strict = (each) => TABLE.strict.includes(each);
  let [rest, groups] = brackets(text);
  let [label, tail] = atTheEnd(ends(rest));
  const words = wordsOf(label), inches = words.at(-1) === "in" && !groups.length && !tail;
  if (words.at(-1) === "in") words.pop();
  let quantity = quantityOf(words);
  const axis = !quantity && tail && abscissa(words, tail[1]); // X-Axis Hz
  if (tail && (words.length || tail[0].length === 1) && !axis && !isStated(tail, quantity)) {
    words.push(tail[0].toLowerCase());
    tail = null;
  }
  if (tail && !words.length && !groups.length) return { quantity: alone(tail), unit: tail[0], means: tail[1], unknown: "", strange: "" };
  groups = ofUnits(groups, quantity);
  const odd = groups.filter((each) => letters(each) && !meaning(each)), [stated, unit] = statedOf(groups, tail), means = unit[1];
  quantity = unlessAnother(quantity || abscissa(words, means), label, odd, means);
  let unknown = stated.find(([, other]) => !same(other, stated.at(-1)[1]))?.[0] ?? "";
  if (odd.length && (!means || (strict(quantity) && !wordsOf(odd.at(-1)).every((each) => TABLE.labels.includes(each))))) unknown = odd.at(-1);
  if (!means && !unknown) unknown = inches && TABLE.motions.includes(quantity) ? "in" : foreign(label);
  if (strict(quantity) && means && !fits(quantity, means)) {
    if (words[0].length === 1) quantity = "";
    else unknown = unit[0];
  }
  const strange = strict(quantity) && !unknown ? strangeOf(text, label, words, quantity, means) : "";
  return { quantity, unit: unit[0], means: unknown ? null : means, unknown, strange };
}

// What the numbers of a column of a quantity mean: by its name, or by the documented default; {factor, ..., text, written}.
export function columnUnit(name, quantity) {
  const stated = heading(name), odd = stated.unknown || stated.strange;
  if (TABLE.negated.includes(odd)) throw new Error(`${name}: ${odd} turns its sign; turn that of its numbers, and name it without`);
  if (odd) throw new Error(`${name}: ${odd} is no unit that is known; name it with one of ${TABLE.known[quantity]}, or without any`);
  const byName = quantity === "frequency" && (name.toLowerCase().match(/\p{L}+/gu) ?? []).some((each) => TABLE.radians.includes(each));
  const text = stated.unit || (byName ? "rad/s" : HOLDS.get(quantity)[2]) || "1", unit = meaning(text);
  if (!unit || !fits(quantity, unit) || unit.power || (unit.decibels && quantity !== "magnitude")) {
    throw new Error(`${name}: ${text} is no unit of a ${quantity}; use one of ${TABLE.known[quantity]}`);
  }
  return { ...unit, text, written: Boolean(stated.unit) || byName };
}
