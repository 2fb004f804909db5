// Tables: narrow screens show each row as a card, whose cells have the headings of their columns; long ones have a filter.
document.querySelectorAll(".content table").forEach((table) => {
  const heads = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent.trim());
  const rows = [...table.querySelectorAll("tbody tr")];
  rows.forEach((row) =>
    [...row.cells].forEach((cell, k) => {
      cell.dataset.head = heads[k] || "";
      cell.classList.toggle("blank", !cell.textContent.trim());
    }),
  );
  if (rows.length < 40) return;
  const filter = document.createElement("input");
  filter.type = "search";
  filter.className = "filter";
  filter.placeholder = "Filter the rows: words that they hold";
  filter.setAttribute("aria-label", filter.placeholder);
  const count = document.createElement("p");
  count.className = "filter-count";
  count.setAttribute("role", "status");
  const show = () => {
    const words = filter.value.toLowerCase().split(/\s+/);
    rows.forEach((row) => (row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word))));
    count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  };
  filter.addEventListener("input", show);
  (table.closest(".table-wrapper") || table).before(filter, count);
  show();
});
// What theme and notebooks leave out: the level of captions, names of folded cells that match, pictures that scroll by keys.
document.querySelectorAll("p.caption[role=heading]").forEach((caption) => caption.setAttribute("aria-level", "2"));
document.querySelectorAll("summary[aria-label]").forEach((summary) => summary.removeAttribute("aria-label"));
document.querySelectorAll(".content p:has(> img)").forEach((picture) => {
  if (picture.scrollWidth > picture.clientWidth) picture.tabIndex = 0;
});
