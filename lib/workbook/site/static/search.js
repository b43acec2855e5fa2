// Ranks the places of the search index for a question: any word may be missing, titles count most, above all those of
// guides; a word that stands nowhere may have one letter wrong. A page's second place stands behind those of others.
"use strict";

globalThis.rankedPlaces = (() => {
  const FILLING = new Set("a an and are at be by can do does for from has have how i in is it me my of on or the there this to use using what when where which with you your".split(" "));
  const WEIGHTS = { guide: 1, page: 2, reference: 0.9, code: 0.4, ledger: 0.6 }; // of a place by its kind; others 1.5
  const TITLED = { guide: 3 }; // where its title has a word of the question
  const [TITLE, FIRST_PART, STEM] = [6, 0.7, 0.5]; // of a word in a title over one in the text; of a word's beginning
  const NAMED = 2; // of a name of the library that the question spells
  const AGAIN = 0.7; // for each better place on the same page

  const plain = (text) => text.replace(/\bh[\s_-]?(?:infinity|inf|∞)(?!\p{L})/giu, "hinfinity");
  const parted = (text) => `${text} ${text.replace(/(?<=\p{Ll}{2})(?=\p{Lu}\p{Ll})|(?<=\p{Ll})(?=\p{Lu}{2})/gu, " ")}`;
  const wordsOf = (text) => parted(plain(text)).toLowerCase().normalize("NFKD").match(/\d+(?:\.\d+)+|[\p{L}\p{N}]+/gu) ?? [];
  const root = (word) => (word.length > 3 && word.endsWith("s") && !word.endsWith("ss") ? word.slice(0, -1) : word);

  // Whether one letter too many, too few, or another, or two in the wrong order, makes one word of the other.
  const near = (a, b) => {
    if (Math.abs(a.length - b.length) > 1) return false;
    let at = 0;
    while (at < a.length && a[at] === b[at]) at += 1;
    const [left, right] = [a.slice(at), b.slice(at)];
    return (
      left.slice(1) === right.slice(1) || left.slice(1) === right || left === right.slice(1) ||
      (left[0] === right[1] && left[1] === right[0] && left.slice(2) === right.slice(2))
    );
  };

  return (index) => {
    const places = index.map(([title, kind, address, text]) => ({
      title, kind, address, text,
      name: kind === "reference" ? root(title.split(".").at(-1).replaceAll("_", "").toLowerCase()) : "",
      head: new Set(wordsOf(title).map(root)),
      all: new Set(wordsOf(`${title} ${kind} ${text}`).map(root)),
    }));
    const count = new Map();
    for (const { all } of places) for (const word of all) count.set(word, (count.get(word) ?? 0) + 1);

    // Known words that a word of the question stands for, each with how well.
    const meant = (word) => {
      const found = new Map(count.has(word) ? [[word, 1]] : []);
      if (word.length > 2) for (const known of count.keys()) if (known !== word && known.startsWith(word)) found.set(known, FIRST_PART);
      if (!found.size && word.length > 4) for (const known of count.keys()) if (near(word, known)) found.set(known, FIRST_PART);
      if (!found.size && word.length > 5) for (const known of count.keys()) if (known.startsWith(word.slice(0, 5))) found.set(known, STEM);
      return found;
    };

    return (question) => {
      const asked = [...new Set(wordsOf(question).map(root))];
      const words = asked.filter((word) => !FILLING.has(word));
      const terms = (words.length ? words : asked).map(meant);
      const scored = places.map((place) => {
        let [score, hits, titled] = [0, 0, false];
        for (const term of terms) {
          let best = 0;
          for (const [word, how] of term) {
            if (!place.all.has(word)) continue;
            const inTitle = place.head.has(word);
            best = Math.max(best, how * Math.log(1 + places.length / count.get(word)) * (inTitle ? TITLE : 1));
            titled ||= inTitle;
          }
          score += best;
          hits += best > 0;
        }
        // Of a short title the words that were asked for are more of what it is about.
        const named = place.name === words.join("") ? NAMED : 1;
        const weight = named * ((titled && TITLED[place.kind]) || (WEIGHTS[place.kind] ?? 1.5));
        return { place, score: score * hits * hits * weight / (1 + 0.04 * place.head.size) };
      });
      const found = scored.filter(({ score }) => score > 0).sort((a, b) => b.score - a.score);
      const before = new Map(); // places of a page so far
      for (const each of found) {
        const page = each.place.address.split("#")[0];
        const better = before.get(page) ?? 0;
        each.score *= AGAIN ** better;
        before.set(page, better + 1);
      }
      found.sort((a, b) => b.score - a.score);
      return { places: found.map(({ place }) => place), words: terms.flatMap((term) => [...term.keys()]) };
    };
  };
})();
