// The ledger's filters and its order; without this script the page shows the whole table.
"use strict";

const form = document.getElementById("filters");

if (form) {
  const body = document.querySelector("#claims tbody");
  const rows = Array.from(body.rows);
  const fields = ["room", "verdict", "kind"];

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
