(() => {
  const { rows, ticked } = JSON.parse(byId("rows").textContent);
  const chosen = new Set(rows.filter((row) => !row.error).slice(0, ticked));
  const quantity = (name) => (row) => row.quantities?.[name] ?? null;
  const QUANTITIES = ["ψ_PM", "L_d", "L_q", "R", "Inverter drop", "i_max"].filter((name) => rows.some(quantity(name)));
  const COLUMNS = [
    ["Date", (row) => row.date ?? "", (row) => (row.date ?? "").slice(0, 16).replace("T", " ")],
    ["Machine", (row) => row.machine ?? ""], ["Serial", (row) => row.serial ?? ""], ["Method", (row) => row.method ?? ""],
    ...QUANTITIES.map((name) => [name, (row) => quantity(name)(row)?.[0] ?? null, (row) => quantity(name)(row)?.[3] ?? ""]),
    ["Covered", (row) => row.coverage ?? null, (row) => (row.coverage === null || row.error ? "" : `${shown(100 * row.coverage)} %`)],
    ["Warnings", (row) => row.warnings?.length ?? null], ["Folder", (row) => row.folder],
  ];
  let [sorted, rising] = [0, false];

  const NUMBERS = new Set([...QUANTITIES, "Covered", "Warnings"]);
  const END = 5;  // of the colour scale, joint standard errors
  const letters = new Map();  // of the results compared; A is the reference
  const lettered = (row) => `${letters.get(row)}: ${row.folder}`;
  const named = (row) => [row.machine || row.folder, row.serial, (row.date ?? "").slice(0, 10)].filter(Boolean).join(", ");
  const text = (row) => [row.date, row.machine, row.serial, row.method, row.folder, row.error].filter(Boolean).join(" ").toLowerCase();

  const label = (name) => made("span", { class: "column" }, ...symbol(name));  // beside a value, where the page is narrow

  function cell([name, value, written], row) {
    const content = name === "Folder" && row.report ? made("a", { href: `${encodeURI(row.folder)}/report.html` }, row.folder)
      : String((written ?? value)(row) ?? "");
    const found = made("td", NUMBERS.has(name) ? { class: "number" } : {}, ...(content ? [label(name), content] : []));
    if (name === "Warnings" && row.warnings?.length) found.title = row.warnings.join("\n");
    return found;
  }

  function line(row) {
    if (row.error) return made("tr", {}, made("td", { colspan: COLUMNS.length + 1, class: "far" }, `${row.folder}: ${row.error}`));
    const box = made("input", { type: "checkbox", "aria-label": `Compare ${named(row)}` });
    box.checked = chosen.has(row);
    box.addEventListener("change", () => { chosen[box.checked ? "add" : "delete"](row); compare(); });
    return made("tr", {}, made("td", {}, label("Compare"), box), ...COLUMNS.map((column) => cell(column, row)));
  }

  function list() {
    const value = COLUMNS[sorted][1];
    const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    const kept = rows.filter((row) => words.every((word) => text(row).includes(word)));
    const order = (a, b) => (value(a) === null) - (value(b) === null)
      || (value(a) < value(b) ? -1 : value(a) > value(b) ? 1 : 0) * (rising ? 1 : -1);
    const none = made("tr", {}, made("td", { colspan: COLUMNS.length + 1 }, rows.length ? "No result matches the filter." : "There are no results here yet."));
    byId("body").replaceChildren(...(kept.length ? kept.sort(order).map(line) : [none]));
    byId("count").textContent = `${kept.length} of ${rows.length} result${rows.length === 1 ? "" : "s"}`;
    byId("head").replaceChildren(made("th", { scope: "col" }, "Compare"), ...COLUMNS.map(([name], n) => {
      const button = made("button", { type: "button" }, ...symbol(name));
      button.addEventListener("click", () => {
        [sorted, rising] = [n, sorted === n ? !rising : true];
        list();
        byId("head").querySelectorAll("button")[n].focus();
      });
      return made("th", { scope: "col", ...(NUMBERS.has(name) ? { class: "number" } : {}), ...(n === sorted ? { "aria-sort": rising ? "ascending" : "descending" } : {}) }, button);
    }));
  }

  /** Differences b - a of two maps at their common nodes: mWb, and in joint standard errors (null where unknown). */
  function difference(a, b, flux) {
    const step = Math.max(a.step, b.step);
    const places = (map) => new Map(map.k_d.map((k, n) => [[k * map.step / step, map.k_q[n] * map.step / step], n])
      .filter(([at]) => at.every(Number.isInteger)).map(([at, n]) => [at.join(), n]));
    const [ours, theirs] = [places(a), places(b)];
    const cells = [], values = [], units = [];
    for (const [at, n] of ours) {
      const m = theirs.get(at);
      if (m === undefined) continue;
      const apart = b[`psi_${flux}`][m] - a[`psi_${flux}`][n];
      const sigma = Math.hypot(a[`sigma_${flux}`][n] ?? 0, b[`sigma_${flux}`][m] ?? 0);
      cells.push(at.split(",").map(Number));
      values.push(apart);
      units.push(sigma > 0 ? apart / sigma : null);
    }
    return { step, cells, values, units };
  }

  const rms = (values) => Math.sqrt(values.reduce((sum, x) => sum + x * x, 0) / values.length);
  const unitsOf = (first, other) => {
    const sigma = Math.hypot(first[1] ?? 0, other[1] ?? 0);
    return sigma > 0 ? (other[0] - first[0]) / sigma : null;
  };

  function compared(first, other, name) {
    const [a, b] = [quantity(name)(first), quantity(name)(other)];
    if (!a || !b) return made("td", { class: "number" }, b ? b[3] : "");
    const units = unitsOf(a, b);
    const apart = units === null ? "" : ` (${units > 0 ? "+" : ""}${shown(units, 2)} σ)`;
    return made("td", { class: "number" }, label(lettered(other)), b[3], made("span", { class: Math.abs(units) > 3 ? "far" : "" }, apart));
  }

  function picture(first, other, flux) {
    if (first.turning !== other.turning) return made("p", {}, `ψ_${flux}: a locked rotor tells no flux of the magnets, so it is not compared with a turning one.`);
    const { step, cells, values, units } = difference(first.map, other.map, flux);
    if (!cells.length) return made("p", {}, `ψ_${flux}: the two maps have no currents in common.`);
    const known = units.filter((x) => x !== null);
    const drawn = known.length ? units : values;
    const largest = drawn.reduce((most, x) => Math.max(most, Math.abs(x ?? 0)), 0);
    const limit = known.length ? END : largest || 1e-9;
    const canvas = made("canvas", { role: "img" });
    drawDisc(canvas, Math.max(first.quantities.i_max[0], other.quantities.i_max[0]), cells, step, drawn, (x) => shade(x / limit, true));
    const unit = quantity("ψ_PM")(first)?.[2] ?? "mWb";
    const inUnit = (milli) => `${shown(milli * { Wb: 1e-3, mWb: 1, "µWb": 1e3 }[unit])} ${unit}`;
    const caption = `ψ_${flux}: ${lettered(other)} minus ${lettered(first)}; rms ${inUnit(rms(values))}`
      + (known.length ? `, rms ${shown(rms(known))} σ, largest ${shown(largest)} σ.` : `; standard errors unknown, full colour at ${inUnit(limit)}.`);
    canvas.setAttribute("aria-label", caption);
    return made("figure", {}, canvas, made("figcaption", {}, ...symbol(caption)));
  }

  function compare() {
    const reference = [...chosen].find((row) => row.folder === byId("reference").value) ?? [...chosen][0];
    byId("reference").replaceChildren(...[...chosen].map((row) => made("option", { value: row.folder, ...(row === reference ? { selected: "" } : {}) }, row.folder)));
    byId("reference").parentElement.hidden = chosen.size < 2;
    const ticked = [...chosen].filter((row) => row !== reference);
    const [first, others] = [reference, ticked.filter((row) => row.machine === reference.machine)];
    const refused = ticked.filter((row) => row.machine !== reference.machine)
      .map((row) => made("p", { class: "note" }, `${row.folder} is of another machine (${row.machine || "unnamed"}) than the reference (${reference.machine || "unnamed"}): not compared.`));
    if (!others.length) return byId("compared").replaceChildren(made("p", {}, "Tick two results or more of one machine in the table."), ...refused);
    letters.clear();
    [first, ...others].forEach((row, n) => letters.set(row, n < 26 ? String.fromCharCode(65 + n) : String(n + 1)));
    const head = [first, ...others].map((row, n) => made("th", { scope: "col", class: "number" }, lettered(row), n ? "" : " (reference)"));
    const body = QUANTITIES.map((name) => made("tr", {}, made("th", { scope: "row" }, ...symbol(name)),
      made("td", { class: "number" }, label(lettered(first)), quantity(name)(first)?.[3] ?? ""), ...others.map((other) => compared(first, other, name))));
    const table = made("table", { class: "cards" }, made("thead", {}, made("tr", {}, made("th", { scope: "col" }, "Quantity"), ...head)), made("tbody", {}, ...body));
    const pictures = others.flatMap((other) => (first.map && other.map ? ["d", "q"].map((flux) => picture(first, other, flux)) : []));
    const missing = pictures.length < 2 * others.length ? [made("p", {}, "Maps of older results are not on this page: drive-id compare shows them.")] : [];
    return byId("compared").replaceChildren(
      ...refused,
      made("p", {}, "In brackets: difference from the reference in joint standard errors, marked beyond 3. Two results of one recording are not independent."),
      made("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Comparison" }, table),
      colourBar(`\u2212${END} σ: less`, `more: +${END} σ of the difference; hatched: no data in one or both`, true), made("div", { class: "pair" }, ...pictures), ...missing);
  }

  const groupOf = (row) => [row.machine, row.serial].filter(Boolean).join(", ");

  function trend() {
    const found = rows.filter((row) => !row.error && row.date && groupOf(row) === byId("group").value);
    byId("trends").replaceChildren(...["ψ_PM", "R"].flatMap((name) => {
      const points = found.filter(quantity(name)).map((row) => {
        const [y, sigma, , written] = quantity(name)(row);
        return { x: Date.parse(row.date), y, sigma, series: row.method, written, row };
      });
      if (!points.length) return [];
      const label = `${name} / ${quantity(name)(points[0].row)[2]}, bars: ±2 σ`;
      const times = points.map((p) => p.x);
      const oneDay = Math.max(...times) - Math.min(...times) < 86400e3;
      const tick = (time) => new Date(time).toISOString().slice(...(oneDay ? [11, Math.max(...times) - Math.min(...times) < 600e3 ? 19 : 16] : [0, 10]));
      const when = oneDay ? `, ${points[0].row.date.slice(0, 10)}` : "";
      return [made("figure", {}, drawTrend(points, `${label}${when}`, (p) => `${p.row.date.slice(0, 16).replace("T", " ")}: ${p.written}, ${p.series}`, tick))];
    }));
    if (!byId("trends").children.length) byId("trends").append(made("p", {}, "No dated results of a named machine: name it with drive-id fit --machine NAME --serial NUMBER."));
  }

  function start() {
    const counts = new Map();
    rows.filter((row) => !row.error && groupOf(row)).forEach((row) => counts.set(groupOf(row), (counts.get(groupOf(row)) ?? 0) + 1));
    const groups = [...counts].sort((a, b) => b[1] - a[1]).map(([name, count]) => made("option", { value: name }, `${name} (${count})`));
    byId("group").append(...groups);
    byId("filter").addEventListener("input", list);
    byId("untick").addEventListener("click", () => { chosen.clear(); list(); compare(); });
    byId("group").addEventListener("change", trend);
    byId("reference").addEventListener("change", compare);
    dark.addEventListener("change", () => { applyTheme(); compare(); });
    list(); compare(); trend();
  }
  start();
})();
