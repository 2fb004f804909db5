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

  /** A cross at the probed current. */
  function mark() {
    const [x, y] = probed();
    const known = Number.isFinite(x) && Number.isFinite(y);
    return known ? [{ x, y, text: "✛", showarrow: false, font: { size: 18, color: "#ff5a36" } }] : [];
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

  /** A field as contours; z is copied, because plotly finds no levels for a new trace that shares its data with the last. */
  function fieldTrace(x, y, z, label, unit, more = {}) {
    return {
      type: "contour", x, y, z: [...z], colorscale: data.colours, colorbar: colourBar(unit), connectgaps: false,
      contours: { coloring: "heatmap", showlabels: true, labelfont: { size: 11, color: "#000000" } },
      line: { width: 0.7, color: "#000000" }, name: markup(label), showlegend: false,
      hovertemplate: `i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>${markup(label)} %{z:.5g} ${unit}%{text}<extra></extra>`,
      ...more,
    };
  }

  // -- the map -------------------------------------------------------------------------------------------------------

  const quantity = () => data.map.quantities.find((entry) => entry.name === byId("map-quantity").value);

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
    const { inside } = data.map;
    const near = (at, count) => [at - 1, at, at + 1].filter((place) => place >= 0 && place < count);
    return near(k, inside.length).flatMap((row) => near(j, inside[row].length).map((column) => [row, column]));
  }

  /** Whether a node lies at or beside one without data, so that the continuation joins the data. */
  function nearGap(k, j) {
    return around(k, j).some(([row, column]) => data.map.inside[row][column] === 0);
  }

  /** Surface x, y, z with a smooth edge: nodes just beyond the data are drawn in to the edge of the smoothed region. */
  function smoothEdged(z) {
    const { i_d, i_q, inside } = data.map;
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

  function drawMap() {
    const chosen = quantity();
    const { i_d, i_q, inside, trajectory } = data.map;
    const flat = byId("map-view").value === "map";
    const known = where(chosen.z, (k, j) => inside[k][j] === 1);
    const rest = where(chosen.z, nearGap);
    const text = chosen.z.map((row, k) => row.map((_, j) =>
      chosen.sigma && chosen.sigma[k][j] !== null ? ` ± ${chosen.sigma[k][j].toPrecision(2)} ${chosen.unit}` : ""));
    const continued = byId("map-continuation").checked && rest.some((row) => row.some((value) => value !== null));
    const traced = byId("map-trajectory").checked;
    const field = fieldTrace(i_d, i_q, known, chosen.label, chosen.unit, { text });
    const grey = [[0, colour("grey")], [1, colour("grey")]];
    if (flat) {
      const traces = [field];
      if (continued) {
        traces.unshift(fieldTrace(i_d, i_q, rest, chosen.label, chosen.unit, {
          colorscale: grey, showscale: false, opacity: 0.45, text: where(text, () => false).map((row) => row.map(() => ", no data")),
        }));
      }
      if (traced) {
        traces.push({ type: "scatter", mode: "lines", x: trajectory.i_d, y: trajectory.i_q, name: "measured",
          line: { color: "#ff5a36", width: 0.8 }, hoverinfo: "skip", showlegend: false });
      }
      return Plotly.react("chart-map", traces, planeLayout(!continued && !traced), config);
    }
    const surface = (z, more) => ({
      type: "surface", x: i_d, y: i_q, z, text, name: field.name, hovertemplate: field.hovertemplate,
      colorscale: data.colours, colorbar: colourBar(chosen.unit), connectgaps: false, ...more,
    });
    const edged = smoothEdged(chosen.z);
    const traces = [surface(edged.z, { x: edged.x, y: edged.y, contours: { z: { show: true, color: colour("text"), width: 1 } } })];
    if (continued) {
      const blank = text.map((row) => row.map(() => ", no data"));
      traces.push(surface(rest, { colorscale: grey, showscale: false, opacity: 0.45, text: blank }));
    }
    if (traced) {
      const heights = trajectory.i_d.map((d, n) => (d === null ? null : interpolated(chosen.z, d, trajectory.i_q[n])));
      traces.push({ type: "scatter3d", mode: "lines", x: trajectory.i_d, y: trajectory.i_q, z: heights,
        line: { color: "#ff5a36", width: 3 }, hoverinfo: "skip", showlegend: false });
    }
    const turn = Number(byId("map-turn").value) * Math.PI / 180;
    const scene = {
      xaxis: axis(currentAxis("d"), { color: colour("text") }),
      yaxis: axis(currentAxis("q"), { color: colour("text") }),
      zaxis: axis(`${markup(chosen.label.split(" = ")[0])} / ${chosen.unit}`, { color: colour("text") }),
      aspectmode: "manual", aspectratio: { x: 1, y: 1, z: 0.75 },
      camera: { eye: { x: 1.7 * Math.cos(turn), y: 1.7 * Math.sin(turn), z: 0.9 }, center: { x: 0, y: 0, z: -0.16 } },
    };
    return Plotly.react("chart-map", traces, layout({ scene, margin: { l: 0, r: 0, t: 30, b: 0 } }), config);
  }

  function probe() {
    const [d, q] = probed();
    for (const name of PLANES) {
      if (byId(`chart-${name}`)?.layout?.xaxis) Plotly.relayout(`chart-${name}`, { annotations: mark() });
    }
    const chosen = quantity();
    const there = interpolated(where(chosen.z, (k, j) => data.map.inside[k][j] === 1), d, q);
    const value = interpolated(chosen.z, d, q);
    const sigma = chosen.sigma ? interpolated(chosen.sigma, d, q) : null;
    const shown = (number, digits) => number.toPrecision(digits).replace("-", "\u2212");
    byId("probe").textContent = there === null
      ? (value === null ? "no data there" : `no data there; continued to ${shown(value, 4)} ${chosen.unit}`)
      : `${chosen.label.split(" = ")[0]} = ${shown(value, 5)}${sigma === null ? "" : ` ± ${shown(sigma, 2)}`} ${chosen.unit}`;
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
    const largest = Math.max(...z.flat().map((value) => Math.abs(value ?? 0)));
    const trace = {
      type: "heatmap", x: data.comparison.i_d, y: data.comparison.i_q, z, zmin: -largest, zmax: largest,
      colorscale: "RdBu", colorbar: colourBar("mWb"),
      hovertemplate: "i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>%{z:.4g} mWb<extra></extra>",
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

  function drawResiduals() {
    const over = byId("residuals-over").value;
    const chosen = data.residuals[over];
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
    const torque = data.map.quantities.find((entry) => entry.name === "torque");
    const traces = [fieldTrace(data.map.i_d, data.map.i_q, torque.z, "torque", "Nm", { text: torque.z.map((row) => row.map(() => "")) })];
    data.operation.lines.forEach((line, k) => traces.push({
      type: "scatter", mode: "lines", x: line.i_d, y: line.i_q, name: line.name,
      line: { color: "#ff5a36", width: 3, dash: ["solid", "dash", "dot"][k % 3] },
      text: line.torque.map((value, n) => {
        const sigma = line.sigma[n] === null ? "" : ` ± ${line.sigma[n].toPrecision(2)}`;
        return value === null ? "" : `${value.toPrecision(4)}${sigma} Nm`;
      }),
      hovertemplate: `${line.name}<br>i<sub>d</sub> %{x:.4g} A<br>i<sub>q</sub> %{y:.4g} A<br>%{text}<extra></extra>`,
    }));
    return Plotly.react("chart-operation", traces, planeLayout(), config);
  }

  function drawEfficiency() {
    const { speed, torque, largest, efficiency } = data.operation.speeds;
    const field = fieldTrace(speed, torque, efficiency, "efficiency", "%", {
      hovertemplate: "%{x:.5g} rpm<br>%{y:.4g} Nm<br>%{z:.4g} %<extra></extra>",
    });
    const known = efficiency.flat().filter((value) => value !== null).sort((a, b) => a - b);
    if (known.length) field.zmin = known[Math.floor(0.05 * known.length)];  // the edge near zero torque would take all colours
    const edge = { type: "scatter", mode: "lines", x: speed, y: largest, name: "largest torque", showlegend: true,
      line: { color: "#ff5a36", width: 3 }, hovertemplate: "%{x:.5g} rpm, %{y:.4g} Nm<extra></extra>" };
    const top = 1.05 * Math.max(...largest);
    const beyond = { type: "scatter", mode: "none", x: [...speed, speed.at(-1), speed[0]], y: [...largest, top, top], fill: "toself",
      fillcolor: colour("page"), hoverinfo: "skip", showlegend: false };
    const axes = { xaxis: axis("speed / rpm", { range: [0, speed.at(-1)] }), yaxis: axis("torque / Nm", { range: [0, top] }) };
    return Plotly.react("chart-efficiency", [field, beyond, edge], layout(axes), config);
  }

  const PLANES = ["map", "comparison", "operation"];
  const charts = {
    map: [drawMap, ["map-quantity", "map-view", "map-continuation", "map-trajectory", "map-turn"]],
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
    for (const id of ["probe-d", "probe-q", "map-quantity"]) onChange(id, probe);
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
