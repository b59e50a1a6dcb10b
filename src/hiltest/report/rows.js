// A click on a point of a drawing opens the table below it, and shows the row with the point's numbers.
addEventListener("click", ({target}) => {
  const point = target.closest("[data-row]");
  const rows = point?.closest("figure")?.querySelectorAll("tbody tr") ?? [];
  if (!rows.length) return;
  const row = rows[point.dataset.row % rows.length];  // marks of several series may share a row
  row.closest("details").open = true;
  row.tabIndex = -1;
  row.focus();
});
