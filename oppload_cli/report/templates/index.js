"use strict";
(() => {
  const body = document.querySelector("#results tbody");
  const rows = [...body.rows];
  const buttons = [...document.querySelectorAll("#results thead button")];

  function sort(key, down) {
    const value = (row) => row.dataset[key];
    const known = rows.filter((row) => value(row) !== "");
    const compare =
      key === "title"
        ? (a, b) => value(a).localeCompare(value(b), undefined, { numeric: true })
        : (a, b) => Number(value(a)) - Number(value(b));
    known.sort((a, b) => (down ? compare(b, a) : compare(a, b)));
    // Rows without a value stay at the end in both directions.
    body.append(...known, ...rows.filter((row) => value(row) === ""));
  }

  for (const button of buttons) {
    button.addEventListener("click", () => {
      const head = button.closest("th");
      const before = head.getAttribute("aria-sort");
      const text = ["title", "first"].includes(button.dataset.key);
      const down = before ? before === "ascending" : !text;
      for (const each of buttons) each.closest("th").removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      sort(button.dataset.key, down);
    });
  }

  document.getElementById("filter").addEventListener("input", (event) => {
    const part = event.target.value.toLowerCase();
    for (const row of rows) row.hidden = !row.dataset.title.toLowerCase().includes(part);
  });
})();
