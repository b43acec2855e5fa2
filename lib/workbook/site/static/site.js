// Conveniences; without this script every page shows all that it has.
"use strict";

// A picture opens at full size over its page; Escape, the button or a click closes it.
const enlarge = (link) => {
  const dialog = document.createElement("dialog");
  dialog.className = "enlarged";
  dialog.setAttribute("aria-label", link.firstElementChild.alt);
  const button = document.createElement("button");
  button.textContent = "Close";
  const picture = document.createElement("img");
  picture.src = link.href;
  picture.alt = link.firstElementChild.alt;
  dialog.append(button, picture);
  dialog.addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
};

for (const link of document.querySelectorAll("a.zoom")) {
  link.addEventListener("click", (event) => {
    if (event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    enlarge(link);
  });
}

// What an address leads to is shown: the folds around it open.
const aimed = () => document.getElementById(decodeURIComponent(location.hash.slice(1)));

const unfold = () => {
  const target = aimed();
  let fold = target?.closest("details:not([open])");
  if (!fold) return;
  for (; fold; fold = fold.parentElement.closest("details:not([open])")) fold.open = true;
  target.scrollIntoView();
};
addEventListener("hashchange", unfold);
unfold();

const allCode = document.getElementById("all-code");

if (allCode) {
  allCode.hidden = false;
  allCode.addEventListener("click", () => {
    const open = allCode.getAttribute("aria-pressed") === "false";
    for (const code of document.querySelectorAll("details.code")) code.open = open;
    allCode.setAttribute("aria-pressed", open);
  });
}

// What a form's fields say stands in the address, so that a view can be kept and sent.

const fromAddress = (form) => {
  for (const [name, value] of new URLSearchParams(location.search)) {
    const field = form.elements[name];
    if (field) field.value = value;
    if (field && field.value !== value) field.value = ""; // no such option
  }
};

const toAddress = (form) => {
  const chosen = new URLSearchParams([...new FormData(form)].filter(([, value]) => value));
  const query = chosen.toString();
  history.replaceState(null, "", (query ? `?${query}` : location.pathname) + location.hash);
};

// Of a list chosen from by keyboard or by a program a browser may tell one of the two only.
const whenChanged = (form, show) => {
  for (const event of ["input", "change"]) form.addEventListener(event, show);
  form.addEventListener("submit", (event) => event.preventDefault());
};

const wordsIn = (text) => text.toLowerCase().split(/\s+/).filter(Boolean);

// The ledger's filters and its order.

const form = document.querySelector("form#filters"); // a function in the reference may be called so, too

if (form) {
  const body = document.querySelector("#claims tbody");
  const rows = Array.from(body.rows);
  const fields = ["topic", "notebook", "counted", "verdict", "kind"];
  const more = document.getElementById("more");
  const PAGE = 50; // rows that are shown at first, and more of them at a time
  let limit = PAGE;
  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

  const distance = (row) => (row.dataset.deviation === "" ? null : Number(row.dataset.deviation));

  const ordered = (order) => {
    if (!order) return rows;
    const sign = order === "farthest" ? -1 : 1;
    return [...rows].sort((a, b) => {
      const [x, y] = [distance(a), distance(b)];
      if (x === null || y === null) return (x === null) - (y === null); // without a deviation: last
      return sign * (x - y);
    });
  };

  const show = () => {
    const wanted = wordsIn(form.elements.q.value);
    let shown = 0;
    for (const row of ordered(form.elements.order.value)) {
      row.hidden =
        fields.some((name) => form.elements[name].value && form.elements[name].value !== row.dataset[name]) ||
        !wanted.every((word) => texts.get(row).includes(word));
      row.classList.toggle("later", !row.hidden && shown >= limit);
      shown += !row.hidden;
      body.append(row);
    }
    more.hidden = shown <= limit;
    more.textContent = `Show ${Math.min(PAGE, shown - limit)} more of ${shown}`;
    document.getElementById("shown").textContent = `${shown} of ${rows.length} numbers`;
    toAddress(form);
  };

  const again = () => {
    limit = PAGE;
    show();
  };
  whenChanged(form, again);
  form.addEventListener("reset", () => setTimeout(again));
  more.addEventListener("click", () => {
    limit += PAGE;
    show();
  });
  // A link to a row must not lead to a hidden one.
  const reveal = () => {
    const target = aimed();
    const row = target?.closest("#claims tr");
    if (!row || !(row.hidden || row.classList.contains("later"))) return;
    if (row.hidden) form.reset();
    setTimeout(() => {
      limit = Infinity;
      show();
      target.scrollIntoView();
    });
  };
  window.addEventListener("hashchange", reveal);
  fromAddress(form);
  show();
  reveal();
}

// The gallery's filters.

const gallery = document.querySelector("form#gallery-filters");

if (gallery) {
  const show = () => {
    const { topic, verdict } = Object.fromEntries(new FormData(gallery));
    let [shown, all] = [0, 0];
    for (const section of document.querySelectorAll("section[data-topic]")) {
      section.hidden = Boolean(topic) && topic !== section.dataset.topic;
      for (const figure of section.querySelectorAll("figure")) {
        figure.hidden = Boolean(verdict) && !figure.dataset.verdicts.split(" ").includes(verdict.replaceAll(" ", "-"));
        shown += !section.hidden && !figure.hidden;
        all += 1;
      }
    }
    document.getElementById("shown").textContent = `${shown} of ${all} figures`;
    toAddress(gallery);
  };
  whenChanged(gallery, show);
  fromAddress(gallery);
  show();
}

// Search; `rankedPlaces` of search.js finds and orders.

const search = document.querySelector("form#search");

if (search) {
  const list = document.getElementById("results");
  const ranked = globalThis.rankedPlaces(globalThis.searchIndex);

  const excerpt = (text, word) => {
    const first = text.toLowerCase().indexOf(word) - 60;
    const at = first > 0 ? text.indexOf(" ", first) + 1 : 0; // from the beginning of a word
    return `${at ? "…" : ""}${text.slice(at, at + 200)}${text.length > at + 200 ? "…" : ""}`;
  };

  const show = () => {
    const { places: found, words } = ranked(search.elements.q.value);
    list.replaceChildren(
      ...found.slice(0, 50).map(({ title, kind, address, text }) => {
        const item = document.createElement("li");
        const link = document.createElement("a");
        link.href = address;
        link.textContent = title;
        const label = document.createElement("span");
        label.className = "kind";
        label.textContent = ` ${kind}`;
        const words_ = document.createElement("p");
        words_.textContent = excerpt(text, words.find((word) => text.toLowerCase().includes(word)) ?? "");
        item.append(link, label, words_);
        return item;
      }),
    );
    const count = `${found.length} place${found.length === 1 ? "" : "s"}${found.length > 50 ? ", the first 50 shown" : ""}`;
    document.getElementById("found").textContent = search.elements.q.value.trim() ? count : "";
    toAddress(search);
  };
  whenChanged(search, show);
  fromAddress(search);
  show();
}

// What is wider than its place, a formula or on a phone the line it stands in, scrolls by keys, too.
const reachWide = () => {
  for (const line of document.querySelectorAll(".equation, :is(p, li, dd):has(> math)"))
    if (getComputedStyle(line).overflowX === "auto" && line.scrollWidth > line.clientWidth) line.setAttribute("tabindex", "0");
    else line.removeAttribute("tabindex");
};
reachWide();
addEventListener("resize", reachWide);
