// Ranks the places of the search index for a question: any word may be missing, titles and guides count most, a word that
// stands nowhere may have one letter wrong.
"use strict";

globalThis.rankedPlaces = (() => {
  const FILLING = new Set("a an and are at be by can do does for from has have how i in is it me my of on or the there this to use using what when where which with you your".split(" "));
  const WEIGHTS = { guide: 3, reference: 0.7, ledger: 0.6 }; // of a place by its kind; a notebook's is 1.5
  const [TITLE, FIRST_PART] = [6, 0.7]; // of a word in a title over one in the text; of a word's beginning

  const wordsOf = (text) => text.toLowerCase().normalize("NFKD").match(/[\p{L}\p{N}]+/gu) ?? [];
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
      return found;
    };

    return (question) => {
      const asked = [...new Set(wordsOf(question).map(root))];
      const words = asked.filter((word) => !FILLING.has(word));
      const terms = (words.length ? words : asked).map(meant);
      const scored = places.map((place) => {
        let [score, hits] = [0, 0];
        for (const term of terms) {
          let best = 0;
          for (const [word, how] of term)
            if (place.all.has(word)) best = Math.max(best, how * Math.log(1 + places.length / count.get(word)) * (place.head.has(word) ? TITLE : 1));
          score += best;
          hits += best > 0;
        }
        // Of a short title the words that were asked for are more of what it is about.
        return { place, score: score * hits * hits * (WEIGHTS[place.kind] ?? 1.5) / (1 + 0.04 * place.head.size) };
      });
      const found = scored.filter(({ score }) => score > 0).sort((a, b) => b.score - a.score);
      return { places: found.map(({ place }) => place), words: terms.flatMap((term) => [...term.keys()]) };
    };
  };
})();
