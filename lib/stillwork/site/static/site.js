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

const allCode = document.getElementById("all-code");

if (allCode) {
  allCode.hidden = false;
  allCode.addEventListener("click", () => {
    const open = allCode.getAttribute("aria-pressed") === "false";
    for (const code of document.querySelectorAll("details.code")) code.open = open;
    allCode.setAttribute("aria-pressed", open);
  });
}

// The ledger's filters and its order.

const form = document.querySelector("form#filters"); // a function in the reference may be called so, too

if (form) {
  const body = document.querySelector("#claims tbody");
  const rows = Array.from(body.rows);
  const fields = ["room", "counted", "verdict", "kind"];

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
    let shown = 0;
    for (const row of ordered(form.elements.order.value)) {
      row.hidden = fields.some((name) => form.elements[name].value && form.elements[name].value !== row.dataset[name]);
      shown += !row.hidden;
      body.append(row);
    }
    document.getElementById("shown").textContent = `${shown} of ${rows.length} numbers`;
  };

  form.addEventListener("change", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("reset", () => setTimeout(show));
  for (const link of document.querySelectorAll("[data-filter]")) {
    link.addEventListener("click", () => {
      const wanted = new URLSearchParams(link.dataset.filter);
      for (const name of fields) form.elements[name].value = wanted.get(name) ?? "";
      show();
    });
  }
  // A link to a row must not lead to a hidden one.
  window.addEventListener("hashchange", () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.hidden) {
      form.reset();
      setTimeout(() => target.scrollIntoView());
    }
  });
  show(); // a reloaded page keeps what was chosen
}
