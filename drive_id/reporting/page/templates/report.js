"use strict";
(() => {
  const root = document.documentElement;
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("charts").textContent);
  const twin = byId("identification").textContent;

  // -- theme ---------------------------------------------------------------------------------------------------------

  const system = window.matchMedia("(prefers-color-scheme: dark)");
  let chosenTheme = null;

  function applyTheme() {
    const dark = chosenTheme === null ? system.matches : chosenTheme === "dark";
    root.dataset.theme = dark ? "dark" : "light";
    byId("theme").setAttribute("aria-pressed", String(dark));
  }

  const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();

  // -- plotly, packed ------------------------------------------------------------------------------------------------

  async function unpackPlotly() {
    const packed = atob(byId("plotly").textContent);
    const bytes = new Uint8Array(packed.length);
    for (let k = 0; k < packed.length; k += 1) bytes[k] = packed.charCodeAt(k);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    byId("plotly").remove();
  }

  function hasWebGL() {
    const context = document.createElement("canvas").getContext("webgl");
    context?.getExtension("WEBGL_lose_context")?.loseContext();
    return context !== null;
  }

  // -- what charts share ---------------------------------------------------------------------------------------------

  const config = { displaylogo: false, responsive: true, scrollZoom: false, modeBarButtonsToRemove: ["sendChartToCloud"] };
  const markup = (label) => label.replace(/_(\w)\b/g, "<sub>$1</sub>").replace(/_(\w\w)\b/g, "<sub>$1</sub>");
  const currentAxis = (component) => `i<sub>${component}</sub> / A`;

  function axis(title, more = {}) {
    const line = { gridcolor: colour("grid"), zerolinecolor: colour("grey"), linecolor: colour("line") };
    return { title: { text: title }, automargin: true, ...line, ...more };
  }

  function layout(more = {}) {
    return {
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: colour("text"), family: "system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif", size: 13 },
      margin: { l: 60, r: 20, t: 76, b: 50 },
      hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("grey"), font: { color: colour("text") } },
      legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom" },
      modebar: { color: colour("grey"), activecolor: colour("text"), bgcolor: "rgba(0,0,0,0)" },
      ...more,
    };
  }

  const probed = () => ["probe-d", "probe-q"].map((id) => byId(id).valueAsNumber);

  /** A cross at the probed current, on each of some planes. */
  function mark(planes = 1) {
    const [x, y] = probed();
    const known = Number.isFinite(x) && Number.isFinite(y);
    return (known ? ["", "2"].slice(0, planes) : []).map((n) => ({
      x, y, xref: `x${n}`, yref: `y${n}`, text: "✛", showarrow: false, font: { size: 18, color: "#ff5a36" },
    }));
  }

  /** What lies beyond the circle of i_max, in the colour of the page: the grid ends there in steps. */
  function beyond() {
    const [n, far] = [180, 4 * data.i_max];
    const at = (k) => [Math.cos, Math.sin].map((of) => (data.i_max * of(2 * Math.PI * k / n)).toFixed(4)).join(" ");
    const circle = Array.from({ length: n }, (_, k) => at(k)).join("L");
    return { type: "path", path: `M-${far} -${far}H${far}V${far}H-${far}ZM${circle}Z`, fillcolor: colour("page"), line: { width: 0 } };
  }

  /** Axes of the current plane, both scaled alike, with the circle of i_max, clipped to it, and the probed current. */
  function planeLayout(clipped = true) {
    const reach = 1.05 * data.i_max;
    return layout({
      annotations: mark(),
      margin: { l: 60, r: 20, t: 36, b: 50 },
      xaxis: axis(currentAxis("d"), { range: [-reach, reach], constrain: "domain" }),
      yaxis: axis(currentAxis("q"), { range: [-reach, reach], scaleanchor: "x", constrain: "domain" }),
      shapes: [...(clipped ? [beyond()] : []), {
        type: "circle", x0: -data.i_max, x1: data.i_max, y0: -data.i_max, y1: data.i_max,
        line: { color: colour("text"), width: 1 },
      }],
    });
  }

  const colourBar = (title) => ({ title: { text: title, side: "right" }, thickness: 14, outlinewidth: 0 });
  const where = (z, kept) => z.map((row, k) => row.map((value, j) => (kept(k, j) ? value : null)));

  const tooltip = (label, unit) => `i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>${markup(label)} %{z:.5g}%{text} ${unit}<extra></extra>`;
  const errors = (z, sigma) => z.map((row, k) => row.map((_, j) => (sigma && sigma[k][j] !== null ? ` ± ${sigma[k][j].toPrecision(2)}` : "")));

  /** Round levels, about ten, that a range holds. */
  function levels(z) {
    const known = z.flat().filter((value) => value !== null);
    const [low, high] = known.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
    const raw = (high - low) / 12 || 1;
    const power = 10 ** Math.floor(Math.log10(raw));
    const size = [1, 2, 5, 10].find((step) => step * power >= raw) * power;
    return { start: Math.ceil(low / size) * size, end: Math.floor(high / size) * size, size };
  }

  /** A field as contours; labels stand only well within the disc, where no edge cuts them. */
  function fieldTraces(x, y, z, label, unit, more = {}, within = null) {
    const at = levels(z);
    const axes = { xaxis: more.xaxis ?? "x", yaxis: more.yaxis ?? "y" };
    const field = {
      type: "contour", x, y, z: [...z], colorscale: data.colours, colorbar: colourBar(unit), connectgaps: false,
      contours: { coloring: "heatmap", ...at }, line: { width: 0.7, color: "#000000" }, name: markup(label), showlegend: false,
      hovertemplate: tooltip(label, unit), text: errors(z, null), ...more,
    };
    const kept = within === null ? z : where(z, (k, j) => within(x[j], y[k]));
    const labels = {
      type: "contour", x, y, z: kept, showscale: false, hoverinfo: "skip", showlegend: false, line: { width: 0 }, ...axes,
      contours: { coloring: "none", showlabels: true, labelfont: { size: 11, color: "#000000" }, ...at },
    };
    return [field, labels];
  }

  /** Colours from blue over white, which is 0, to red. */
  function signed(z) {
    const largest = Math.max(...z.flat().map((value) => Math.abs(value ?? 0)));
    return { colorscale: "RdBu", zmin: -largest, zmax: largest };
  }
  const inDisc = (x, y) => Math.hypot(x, y) < 0.88 * data.i_max;

  // -- the map -------------------------------------------------------------------------------------------------------

  const named = (name) => data.map.quantities.find((entry) => entry.name === name);
  const chosenParts = () => data.map.views.find((view) => view.label === byId("map-quantity").value).parts.map(named);

  /** Value at a current by bilinear interpolation of z[k][j]; null outside the grid or without data. */
  function interpolated(z, d, q) {
    const { i_d, i_q } = data.map;
    const place = (values, x) => {
      if (!(x >= values[0] && x <= values[values.length - 1])) return null;
      let cell = values.findIndex((value) => value > x) - 1;
      if (cell < 0) cell = values.length - 2;
      return [cell, (x - values[cell]) / (values[cell + 1] - values[cell])];
    };
    const [at, across] = [place(i_d, d), place(i_q, q)];
    if (at === null || across === null) return null;
    const [[j, t], [k, s]] = [at, across];
    let sum = 0;
    for (const [row, column, weight] of [[k, j, (1 - s) * (1 - t)], [k, j + 1, (1 - s) * t], [k + 1, j, s * (1 - t)], [k + 1, j + 1, s * t]]) {
      if (weight === 0) continue;
      if (z[row][column] === null) return null;
      sum += weight * z[row][column];
    }
    return sum;
  }

  /** Rows and columns of a node of the map and its neighbours. */
  function around(k, j) {
    const { known: inside } = data.map;
    const near = (at, count) => [at - 1, at, at + 1].filter((place) => place >= 0 && place < count);
    return near(k, inside.length).flatMap((row) => near(j, inside[row].length).map((column) => [row, column]));
  }

  /** Whether a node lies at or beside one without data, so that the continuation joins the data. */
  function nearGap(k, j) {
    return around(k, j).some(([row, column]) => data.map.known[row][column] === 0);
  }

  /** Surface x, y, z with a smooth edge: nodes just beyond the data are drawn in to the edge of the smoothed region. */
  function smoothEdged(z) {
    const { i_d, i_q, known: inside } = data.map;
    const smoothed = (nodes) => nodes.map((row, k) => row.map((_, j) => {
      let [sum, count] = [0, 0];
      for (const [r, c] of around(k, j)) {
        const weight = (r === k ? 2 : 1) * (c === j ? 2 : 1);
        sum += weight * nodes[r][c];
        count += weight;
      }
      return sum / count;
    }));
    const region = smoothed(smoothed(inside));
    const level = 0.35;  // a strip as narrow as one node stays
    const x = z.map(() => [...i_d]);
    const y = z.map((row, k) => row.map(() => i_q[k]));
    const height = z.map((row, k) => row.map((value, j) => {
      if (region[k][j] >= level) return value;
      const [r, c] = around(k, j).reduce((best, at) => (region[at[0]][at[1]] > region[best[0]][best[1]] ? at : best));
      if (region[r][c] <= level) return null;
      const share = (level - region[k][j]) / (region[r][c] - region[k][j]);
      x[k][j] += share * (i_d[c] - i_d[j]);
      y[k][j] += share * (i_q[r] - i_q[k]);
      return interpolated(z, x[k][j], y[k][j]) ?? z[r][c];
    }));
    return { x, y, z: height };
  }

  const known = (chosen) => where(chosen.z, (k, j) => data.map.known[k][j] === 1);
  const noData = (z) => z.map((row) => row.map(() => ", no data"));
  const grey = () => ({ colorscale: [[0, colour("grey")], [1, colour("grey")]], showscale: false, opacity: 0.45 });
  const LINE = "#ff5a36";

  /** Lines of operation on the current plane; in the legend once. */
  function operationLines(axes, first) {
    return (data.operation?.lines ?? []).map((line, k) => ({
      type: "scatter", mode: "lines", x: line.i_d, y: line.i_q, name: line.name, showlegend: first, legendgroup: line.name, ...axes,
      line: { color: LINE, width: 3, dash: ["solid", "dash", "dot"][k % 3] },
      text: line.torque.map((value, n) => (value === null ? ""
        : `${value.toPrecision(4)}${line.sigma[n] === null ? "" : ` ± ${line.sigma[n].toPrecision(2)}`} Nm`)),
      hovertemplate: `${line.name}<br>i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>%{text}<extra></extra>`,
    }));
  }

  /** Where the flux at a speed takes all of the voltage, R left aside. */
  function ellipses(axes, first) {
    if (!data.limit) return [];
    const [psi_d, psi_q] = [named("psi_d"), named("psi_q")];
    const z = psi_d.z.map((row, k) => row.map((value, j) => Math.hypot(value, psi_q.z[k][j])));
    const perWb = { Wb: 1, mWb: 1e3, "µWb": 1e6 }[psi_d.unit];
    const speeds = byId("map-speeds").value.split(/[,;\s]+/).map(Number).filter((speed) => speed > 0);
    return speeds.map((speed, n) => {
      const level = perWb * data.limit.voltage / (speed * Math.PI / 30 * data.limit.pole_pairs);
      return {
        type: "contour", x: data.map.i_d, y: data.map.i_q, z, showscale: false, hoverinfo: "skip", ...axes,
        contours: { coloring: "none", start: level, end: level, size: 1 }, name: `limit at ${speed} rpm`, showlegend: first,
        line: { color: colour("text"), width: 2, dash: ["dash", "dot", "dashdot"][n % 3] }, colorscale: [[0, colour("text")], [1, colour("text")]],
      };
    });
  }

  const circle = (share, axes) => ({
    type: "circle", x0: -share * data.i_max, x1: share * data.i_max, y0: -share * data.i_max, y1: share * data.i_max,
    line: { color: share < 1 ? "#00000066" : colour("text"), width: 1, ...(share < 1 ? { dash: "dot" } : {}) }, xref: axes.xaxis, yref: axes.yaxis,
  });

  const isNarrow = (chart) => byId(chart).clientWidth < 640;

  /** Where each of some planes lies in a chart: side by side, on a narrow page one below the other. */
  function placesIn(chart, count) {
    const narrow = isNarrow(chart);
    const domain = (n) => (count < 2 ? [0, narrow ? 1 : 0.55] : n ? [0.56, 0.96] : [0, 0.4]);
    return (n) => (narrow ? { x: [0, 1], y: count < 2 ? [0.3, 1] : n ? [0, 0.42] : [0.56, 0.98] } : { x: domain(n), y: [0, 1] });
  }

  /** Layout of current planes with these labels, and the axes and the colour bar of each. */
  function planes(chart, labels, unit, clipped, top) {
    const [place, reach] = [placesIn(chart, labels.length), 1.05 * data.i_max];
    const found = layout({ margin: { l: 60, r: 20, t: top, b: 50 }, shapes: [], annotations: mark(labels.length), legend: { orientation: "h", x: 0, y: 1.06, yanchor: "bottom" } });
    const panels = labels.map((label, n) => {
      const [suffix, at] = [n ? "2" : "", place(n)];
      const axes = { xaxis: `x${suffix}`, yaxis: `y${suffix}` };
      found[`xaxis${suffix}`] = axis(currentAxis("d"), { range: [-reach, reach], constrain: "domain", domain: at.x, anchor: axes.yaxis });
      found[`yaxis${suffix}`] = axis(currentAxis("q"), { range: [-reach, reach], scaleanchor: axes.xaxis, constrain: "domain", domain: at.y, anchor: axes.xaxis });
      found.shapes.push(...(clipped ? [{ ...beyond(), xref: axes.xaxis, yref: axes.yaxis }] : []), ...[0.25, 0.5, 0.75, 1].map((share) => circle(share, axes)));
      found.annotations.push({ text: `<b>${markup(label)}</b>`, showarrow: false, xref: "paper", yref: "paper", x: at.x[0], y: at.y[1], xanchor: "left", yanchor: "bottom" });
      return { axes, colorbar: { ...colourBar(unit), title: { text: unit, side: "top" }, x: at.x[1] + 0.005, y: (at.y[0] + at.y[1]) / 2, len: at.y[1] - at.y[0] } };
    });
    return [found, panels];
  }

  /** Both parts of a view. */
  function drawMap() {
    const parts = chosenParts();
    if (byId("map-view").value === "surface") return drawSurfaces(parts, placesIn("chart-map", parts.length));
    const { i_d, i_q, trajectory } = data.map;
    const [continued, traced] = [byId("map-continuation").checked, byId("map-trajectory").checked];
    const [found, panels] = planes("chart-map", parts.map((part) => part.label), parts[0].unit, !continued && !traced, 100);
    const traces = parts.flatMap((part, n) => {
      const { axes, colorbar } = panels[n];
      const z = known(part);
      const own = [...fieldTraces(i_d, i_q, z, part.label, part.unit, { text: errors(z, part.sigma), colorbar, ...(part.signed ? signed(z) : {}), ...axes }, inDisc),
        { type: "heatmap", x: i_d, y: i_q, z: where(z, (k, j) => data.map.inside[k][j] === 0).map((row) => row.map((value) => (value === null ? null : 1))),
          colorscale: [[0, colour("page")], [1, colour("page")]], opacity: 0.3, showscale: false, hoverinfo: "skip", ...axes },
        ...operationLines(axes, n === 0), ...ellipses(axes, n === 0)];
      if (continued) {
        const rest = where(part.z, nearGap);
        own.unshift({ ...fieldTraces(i_d, i_q, rest, part.label, part.unit, axes)[0], ...grey(), text: noData(rest) });
      }
      if (traced) {
        own.push({ type: "scatter", mode: "lines", x: trajectory.i_d, y: trajectory.i_q, ...axes,
          line: { color: LINE, width: 0.8 }, hoverinfo: "skip", showlegend: false });
      }
      return own;
    });
    return Plotly.react("chart-map", traces, found, config);
  }

  function drawSurfaces(parts, place) {
    const { i_d, i_q, trajectory } = data.map;
    const { clientWidth, clientHeight } = byId("chart-map");
    const turn = Number(byId("map-turn").value) * Math.PI / 180;
    const found = layout({ margin: { l: 0, r: 0, t: 30, b: 0 }, annotations: [] });
    const spaced = (title) => axis(title, { color: colour("text"), nticks: 5, tickfont: { size: 11 }, tickangle: 0 });
    const traces = parts.flatMap((part, n) => {
      const [scene, at] = [`scene${n ? 2 : ""}`, place(n)];
      const [width, height] = [clientWidth * (at.x[1] - at.x[0]), clientHeight * (at.y[1] - at.y[0])];
      const far = 2 * Math.max(1, 0.97 * height / width); // of the camera, or a narrow scene loses its labels
      const bar = { ...colourBar(part.unit), title: { text: part.unit, side: "top" }, x: at.x[1], y: (at.y[0] + at.y[1]) / 2, len: 0.8 * (at.y[1] - at.y[0]) };
      const surface = (z, more) => ({
        type: "surface", x: i_d, y: i_q, z, text: errors(part.z, part.sigma), name: markup(part.label), hovertemplate: tooltip(part.label, part.unit),
        colorscale: data.colours, colorbar: bar, connectgaps: false, scene, ...(part.signed ? { colorscale: "RdBu", cmid: 0 } : {}), ...more,
      });
      found[scene] = {
        domain: at, xaxis: spaced(currentAxis("d")), yaxis: spaced(currentAxis("q")), zaxis: spaced(""),
        aspectmode: "manual", aspectratio: { x: 1, y: 1, z: 0.75 },
        camera: { eye: { x: far * Math.cos(turn), y: far * Math.sin(turn), z: 0.52 * far }, center: { x: 0, y: 0, z: -0.1 } },
      };
      found.annotations.push({ text: `<b>${markup(part.label)}</b>`, showarrow: false, xref: "paper", yref: "paper", x: at.x[0], y: at.y[1], xanchor: "left", yanchor: "bottom" });
      const edged = smoothEdged(part.z);
      const own = [surface(edged.z, { x: edged.x, y: edged.y, contours: { z: { show: true, color: colour("text"), width: 1 } } })];
      if (byId("map-continuation").checked) {
        const rest = where(part.z, nearGap);
        own.push(surface(rest, { ...grey(), text: noData(rest) }));
      }
      if (byId("map-trajectory").checked) {
        const heights = trajectory.i_d.map((d, k) => (d === null ? null : interpolated(part.z, d, trajectory.i_q[k])));
        own.push({ type: "scatter3d", mode: "lines", x: trajectory.i_d, y: trajectory.i_q, z: heights, scene,
          line: { color: LINE, width: 3 }, hoverinfo: "skip", showlegend: false });
      }
      return own;
    });
    return Plotly.react("chart-map", traces, found, config);
  }

  /** One flux over its own current through the probed one, with its band. */
  function drawSlices() {
    const [d, q] = probed();
    const { i_d, i_q } = data.map;
    const narrow = isNarrow("chart-slices");
    const slices = [["psi_d", i_d, (x) => [x, q], "x", "y"], ["psi_q", i_q, (x) => [d, x], "x2", "y2"]];
    const traces = slices.flatMap(([name, over, at, xaxis, yaxis]) => {
      const part = named(name);
      const [value, sigma] = [known(part), part.sigma].map((z) => over.map((x) => (z === null ? null : interpolated(z, ...at(x)))));
      const line = { type: "scatter", mode: "lines", x: over, xaxis, yaxis, showlegend: false, connectgaps: false };
      const tip = { text: sigma.map((s) => (s === null ? "" : ` ± ${s.toPrecision(2)}`)), hovertemplate: `%{x:.4g} A: %{y:.5g}%{text} ${part.unit}<extra></extra>` };
      const edge = (sign) => value.map((y, n) => (y === null || sigma[n] === null ? null : y + sign * 1.96 * sigma[n]));
      const hidden = { ...line, line: { width: 0 }, hoverinfo: "skip" };
      return [{ ...hidden, y: edge(-1) }, { ...hidden, y: edge(1), fill: "tonexty", fillcolor: `${colour("d")}55` },
        { ...line, ...tip, y: value, line: { color: colour("d"), width: 2 } }];
    });
    const title = (component) => `ψ<sub>${component}</sub> / ${named(`psi_${component}`).unit}`;
    return Plotly.react("chart-slices", traces, layout({
      margin: { l: 60, r: 20, t: 20, b: 50 },
      xaxis: axis(currentAxis("d"), { domain: narrow ? [0, 1] : [0, 0.45] }), yaxis: axis(title("d"), { domain: narrow ? [0.62, 1] : [0, 1] }),
      xaxis2: axis(currentAxis("q"), { domain: narrow ? [0, 1] : [0.55, 1], anchor: "y2" }), yaxis2: axis(title("q"), { domain: narrow ? [0, 0.38] : [0, 1], anchor: "x2" }),
    }), config);
  }

  function probe() {
    const [d, q] = probed();
    for (const name of PLANES) {
      const chart = byId(`chart-${name}`);
      if (chart?.layout?.xaxis) Plotly.relayout(chart, { annotations: [...mark(chart.layout.xaxis2 ? 2 : 1), ...(chart.layout.annotations ?? []).filter((note) => note.text !== "✛")] });
    }
    if (byId("chart-slices")?.data) drawSlices();
    const shown = (number, digits) => number.toPrecision(digits).replace("-", "\u2212");
    const rounded = (value, sigma) => {
      if (!sigma) return shown(value, 5);
      const digits = Math.max(0, 1 - Math.floor(Math.log10(sigma)));
      return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)}`.replace("-", "\u2212");
    };
    const told = data.map.quantities.filter((part) => !/^(sigma|h\d)/.test(part.name) && (part.name.startsWith("psi") || interpolated(part.z, d, q) !== null));
    byId("probe").replaceChildren(...told.map((part) => {
      const [there, value] = [interpolated(known(part), d, q), interpolated(part.z, d, q)];
      const sigma = part.sigma ? interpolated(part.sigma, d, q) : null;
      const line = document.createElement("div");
      line.innerHTML = markup(part.label.split(" = ")[0]);
      line.append(there === null ? (value === null ? ": no data there" : `: no data there; continued to ${shown(value, 4)} ${part.unit}`)
        : ` = ${rounded(there, sigma)} ${part.unit}`);
      return line;
    }));
  }

  /** Set the probe by a click on a chart over the current plane. */
  function probeAt({ points: [{ x, y }] }) {
    [byId("probe-d").value, byId("probe-q").value] = [x, y].map((value) => String(Number(value.toPrecision(5))));
    probe();
  }

  // -- the other charts ----------------------------------------------------------------------------------------------

  function drawComparison() {
    const chosen = data.comparison.methods.find((entry) => entry.name === byId("comparison-method").value);
    const flux = byId("comparison-flux").value;
    const z = chosen[flux];
    const trace = {
      type: "heatmap", x: data.comparison.i_d, y: data.comparison.i_q, z, ...signed(z), colorbar: colourBar(chosen.unit),
      text: errors(z, named(flux).sigma), hovertemplate: tooltip(`Δψ_${flux.at(-1)}`, chosen.unit),
    };
    return Plotly.react("chart-comparison", [trace], planeLayout(), config);
  }

  function drawInverter() {
    const { current, voltage, sigma, phases } = data.inverter;
    const line = { color: colour("d"), width: 2 };
    const traces = [];
    if (sigma !== null) {
      const edge = (sign) => voltage.map((value, k) => value + sign * 1.96 * sigma[k]);
      const hidden = { type: "scatter", mode: "lines", x: current, line: { width: 0 }, hoverinfo: "skip" };
      traces.push({ ...hidden, y: edge(-1), showlegend: false });
      traces.push({ ...hidden, y: edge(1), fill: "tonexty", fillcolor: `${colour("d")}44`, name: "95 % band" });
    }
    traces.push({ type: "scatter", mode: "lines", x: current, y: voltage, line, name: "identified",
      hovertemplate: "%{x:.4g} A, %{y:.4g} V<extra></extra>" });
    (phases ?? []).forEach((phase, k) => traces.push({ type: "scatter", mode: "lines", x: current, y: phase,
      name: `phase ${"abc"[k]}`, line: { color: colour("text"), width: 1, dash: ["dash", "dot", "dashdot"][k] } }));
    return Plotly.react("chart-inverter", traces, layout({ xaxis: axis("phase current / A"), yaxis: axis("drop / V") }), config);
  }

  /** The residual over the current plane: its mean or its rms in each cell, both components in one scale. */
  function drawResidualPlane(statistic) {
    const { i_d, i_q, commanded, ...values } = data.residuals.plane;
    const parts = ["d", "q"].map((component) => values[`${statistic}_${component}`]);
    const labels = ["d", "q"].map((component) => `${component}: ${statistic} of the residual`);
    const both = parts.flatMap((z) => where(z, (k, j) => Math.hypot(i_d[j], i_q[k]) < data.i_max));
    const scale = statistic === "mean" ? signed(both) : { colorscale: data.colours, zmin: 0, zmax: Math.max(...both.flat()) };
    const [found, panels] = planes("chart-residuals", labels, "V", true, 60);
    const traces = parts.map((z, n) => ({
      type: "heatmap", x: i_d, y: i_q, z, ...scale, colorbar: panels[n].colorbar, hoverongaps: false, ...panels[n].axes,
      text: z.map((row) => row.map((value) => (value === null ? "" : `${(100 * value / commanded).toPrecision(2)} %`))),
      hovertemplate: `i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>${statistic} %{z:.3g} V<br>%{text} of the commanded voltage<extra></extra>`,
    }));
    return Plotly.react("chart-residuals", traces, found, config);
  }

  function drawResiduals() {
    const over = byId("residuals-over").value;
    const chosen = data.residuals[over];
    const chart = byId("chart-residuals");
    if (chart.classList.contains("tall") !== (over === "plane")) {
      chart.classList.toggle("tall");
      Plotly.purge(chart);  // it is drawn in another size
    }
    if (over === "plane") return drawResidualPlane(byId("residuals-statistic").value);
    const shown = byId("residuals-statistic").value === "mean" ? ["mean", "rms"] : ["rms"];
    const traces = shown.flatMap((statistic) => ["d", "q"].map((component) => ({
      type: "scatter", mode: "lines", x: chosen.x, y: chosen[`${statistic}_${component}`],
      name: `${component}: ${statistic}`,
      line: { color: colour(component), width: statistic === "mean" ? 2 : 1, dash: component === "d" ? "solid" : "dash" },
      opacity: statistic === "rms" && shown.length === 2 ? 0.6 : 1,
    })));
    const x = over === "time" ? axis("time of data / s") : axis("electrical angle / °", { range: [0, 360], dtick: 60 });
    return Plotly.react("chart-residuals", traces, layout({ xaxis: x, yaxis: axis("residual / V") }), config);
  }

  function drawCurrents() {
    const excerpt = byId("currents-show").value === "excerpt";
    const found = data.currents;
    const line = (component, name, more) => ({
      type: "scatter", mode: "lines", x: found.time, y: found[`${name}_${component}`], name: `i<sub>${component}</sub> ${name}`,
      yaxis: component === "d" ? "y2" : "y", ...more,
    });
    if (!excerpt) {
      const traces = ["d", "q"].map((component) => ({
        type: "scatter", mode: "lines", x: found.bin_time, y: found[`deviation_${component}`],
        name: `i<sub>${component}</sub>`, line: { color: colour(component), dash: component === "d" ? "solid" : "dash" },
      }));
      const axes = { xaxis: axis("time of data / s"), yaxis: axis("mean deviation / A", { rangemode: "tozero" }) };
      return Plotly.react("chart-currents", traces, layout(axes), config);
    }
    const traces = ["d", "q"].flatMap((component) => [
      line(component, "measured", { line: { color: colour("grey"), width: 3 } }),
      line(component, "simulated", { line: { color: colour(component), width: 1.2 } }),
    ]);
    return Plotly.react("chart-currents", traces, layout({
      xaxis: axis("time of data / s", { anchor: "y" }),
      yaxis: axis(currentAxis("q"), { domain: [0, 0.46] }),
      yaxis2: axis(currentAxis("d"), { domain: [0.54, 1] }),
    }), config);
  }

  function drawOperation() {
    const torque = named("torque");
    const axes = { xaxis: "x", yaxis: "y" };
    const field = fieldTraces(data.map.i_d, data.map.i_q, torque.z, "torque", torque.unit, { text: errors(torque.z, torque.sigma), ...signed(torque.z) }, inDisc);
    return Plotly.react("chart-operation", [...field, ...operationLines(axes, true)], planeLayout(), config);
  }

  function drawEfficiency() {
    const { speed, torque, largest, efficiency } = data.operation.speeds;
    const fields = fieldTraces(speed, torque, efficiency, "efficiency", "%", {
      hovertemplate: "%{x:.5g} rpm<br>%{y:.4g} Nm<br>%{z:.4g} %<extra></extra>",
    });
    const known = efficiency.flat().filter((value) => value !== null).sort((a, b) => a - b);
    if (known.length) fields[0].zmin = known[Math.floor(0.05 * known.length)];  // the edge near zero torque would take all colours
    const edge = { type: "scatter", mode: "lines", x: speed, y: largest, name: "largest torque", showlegend: true,
      line: { color: "#ff5a36", width: 3 }, hovertemplate: "%{x:.5g} rpm, %{y:.4g} Nm<extra></extra>" };
    const top = 1.05 * Math.max(...largest);
    const beyond = { type: "scatter", mode: "none", x: [...speed, speed.at(-1), speed[0]], y: [...largest, top, top], fill: "toself",
      fillcolor: colour("page"), hoverinfo: "skip", showlegend: false };
    const axes = { xaxis: axis("speed / rpm", { range: [0, speed.at(-1)] }), yaxis: axis("torque / Nm", { range: [0, top] }) };
    return Plotly.react("chart-efficiency", [...fields, beyond, edge], layout(axes), config);
  }

  const PLANES = ["map", "comparison", "operation"];
  const charts = {
    map: [drawMap, ["map-quantity", "map-view", "map-continuation", "map-trajectory", "map-turn", ...(data.limit ? ["map-speeds"] : [])]],
    slices: [drawSlices, []],
    comparison: [drawComparison, ["comparison-method", "comparison-flux"]],
    inverter: [drawInverter, []],
    residuals: [drawResiduals, ["residuals-over", "residuals-statistic"]],
    currents: [drawCurrents, ["currents-show"]],
    operation: [drawOperation, []],
    efficiency: [drawEfficiency, []],
  };
  const shown = () => Object.keys(charts).filter((name) => byId(`chart-${name}`) !== null);

  const idle = () => new Promise((resolve) => {
    if ("requestIdleCallback" in window) requestIdleCallback(resolve, { timeout: 500 });
    else setTimeout(resolve, 50);
  });

  /** Draw the first chart at once and the others while the browser has nothing else to do. */
  async function drawAll() {
    delete root.dataset.drawn;
    const [first, ...others] = shown();
    await charts[first][0]();
    root.dataset.ready = "true";
    for (const name of others) {
      await idle();
      await charts[name][0]();
    }
    for (const name of PLANES.filter((plane) => shown().includes(plane))) {
      byId(`chart-${name}`).removeAllListeners("plotly_click");
      byId(`chart-${name}`).on("plotly_click", probeAt);
    }
    root.dataset.drawn = "true";
  }

  // -- controls ------------------------------------------------------------------------------------------------------

  /** Call when a control has another value: of a slider or a number, already while it moves. */
  function onChange(id, act) {
    const control = byId(id);
    const moves = control.type === "range" || control.type === "number";
    control.addEventListener(moves ? "input" : "change", act);
  }

  function connect() {
    for (const name of shown()) {
      const [draw, controls] = charts[name];
      for (const id of controls) onChange(id, draw);
    }
    onChange("map-view", () => { byId("map-turn").disabled = byId("map-view").value === "map"; });
    for (const id of ["probe-d", "probe-q"]) onChange(id, probe);
    byId("theme").addEventListener("click", () => {
      chosenTheme = root.dataset.theme === "dark" ? "light" : "dark";
      applyTheme();
      drawAll();
    });
    system.addEventListener("change", () => { applyTheme(); drawAll(); });
    byId("print").addEventListener("click", () => window.print());
    window.addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
    byId("download").addEventListener("click", download);
    byId("copy").addEventListener("click", copy);
  }

  function download() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([twin], { type: "application/json" }));
    link.download = "identification.json";
    link.click();
    URL.revokeObjectURL(link.href);
  }

  async function copy() {
    const text = byId("paragraph").textContent;
    try {
      await navigator.clipboard.writeText(text);
      byId("copy").textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(byId("paragraph"));
      byId("copy").textContent = "Selected: press Ctrl+C";
    }
  }

  async function start() {
    applyTheme();
    root.classList.add("interactive");
    connect();
    if (!hasWebGL()) {
      byId("map-view").value = "map";
      byId("map-view").disabled = true;
      byId("map-turn").disabled = true;
    }
    await unpackPlotly();
    probe();
    await drawAll();
  }

  start().catch((error) => {
    root.classList.remove("interactive");
    byId("status").textContent = "This browser cannot draw the interactive charts: pictures stand in their place.";
    console.error(error);
  });
})();
