// Convenience only: everything is readable without it.
"use strict";

// A click on a heading sorts the table by that column, a second one the other way.
for (const table of document.querySelectorAll("table.numbers")) {
  const body = table.tBodies[0];
  const headings = table.tHead.rows[table.tHead.rows.length - 1].cells;
  [...headings].forEach((heading, column) => {
    heading.setAttribute("aria-sort", "none");
    heading.title = "sort";
    heading.addEventListener("click", () => {
      const rising = heading.getAttribute("aria-sort") !== "ascending";
      for (const other of headings) other.setAttribute("aria-sort", "none");
      heading.setAttribute("aria-sort", rising ? "ascending" : "descending");
      const value = row => Number.parseFloat(row.cells[column].dataset.value ?? "NaN");
      const text = row => row.cells[column].textContent;
      const order = (a, b) => column === 0 ? text(a).localeCompare(text(b)) : value(a) - value(b);
      const missing = row => column > 0 && Number.isNaN(value(row));
      const rows = [...body.rows].sort((a, b) => missing(a) - missing(b) || (rising ? order(a, b) : order(b, a)));
      body.append(...rows);
    });
  });
}

// A pointer over a legend brings its line out in all graphs.
for (const item of document.querySelectorAll(".legend li")) {
  const bring = chosen => {
    for (const series of document.querySelectorAll("g[data-series]")) {
      series.classList.toggle("away", chosen !== null && series.dataset.series !== chosen);
    }
  };
  item.addEventListener("pointerenter", () => bring(item.dataset.series));
  item.addEventListener("pointerleave", () => bring(null));
}
