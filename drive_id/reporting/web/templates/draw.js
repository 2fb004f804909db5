"use strict";
const byId = (id) => document.getElementById(id);
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const applyTheme = () => { document.documentElement.dataset.theme = dark.matches ? "dark" : "light"; };
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
applyTheme();
document.documentElement.classList.add("interactive");

/** Make an element; text is never taken for markup. */
function made(tag, attributes = {}, ...children) {
  const svg = ["svg", "g", "path", "circle", "text", "tspan", "rect", "line", "title"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** A name with the index of its symbol lowered, as nodes. */
const symbol = (name, tag = "sub") => name.split(/_(PM|max|[dq]{1,2})\b/).map((part, n) => (n % 2 ? made(tag, {}, part) : part));

const shown = (value, digits = 3) => (value === null || !Number.isFinite(value) ? "unknown"
  : String(Number(value.toPrecision(digits))).replace("-", "\u2212"));

/** A colour for a share from 0 to 1 (dark to light), or from -1 to 1 (blue, white, red). */
function shade(share, signed) {
  if (signed) {
    const fade = Math.round(255 * (1 - Math.min(Math.abs(share), 1)));
    return share < 0 ? `rgb(${fade},${fade},255)` : `rgb(255,${fade},${fade})`;
  }
  const t = Math.min(Math.max(share, 0), 1);
  return `rgb(${Math.round(20 + 233 * t)},${Math.round(45 + 180 * t)},${Math.round(110 - 70 * t)})`;
}

/** A bar of colours with its ends named. */
function colourBar(low, high, signed) {
  const stops = Array.from({ length: 11 }, (_, k) => shade(signed ? k / 5 - 1 : k / 10, signed));
  const strip = made("span", { class: "strip" });
  strip.style.background = `linear-gradient(to right, ${stops.join()})`;
  return made("div", { class: "bar" }, made("span", {}, low), strip, made("span", {}, high));
}

/** Draw cells around nodes (k_d, k_q) times a step in a disc of the current plane, hatched where there are none. */
function drawDisc(canvas, reach, cells, step, values, paint, radius = `${shown(reach, 4)} A`) {
  const size = canvas.width = canvas.height = 480;
  const context = canvas.getContext("2d");
  const scale = size / (2.3 * reach);
  const [x, y] = [(d) => size / 2 + scale * d, (q) => size / 2 - scale * q];
  context.save();
  context.arc(size / 2, size / 2, scale * reach, 0, 2 * Math.PI);
  context.clip();
  context.fillStyle = colour("panel");
  context.fillRect(0, 0, size, size);
  context.strokeStyle = colour("grey");
  context.beginPath();
  for (let k = -size; k < size; k += 8) { context.moveTo(k, size); context.lineTo(k + size, 0); }
  context.stroke();
  cells.forEach(([d, q], n) => {
    if (values[n] === null) return;
    context.fillStyle = paint(values[n]);
    context.fillRect(Math.floor(x((d - 0.5) * step)), Math.floor(y((q + 0.5) * step)), Math.ceil(step * scale) + 1, Math.ceil(step * scale) + 1);
  });
  context.restore();
  context.strokeStyle = context.fillStyle = colour("text");
  context.font = "14px sans-serif";
  context.beginPath();
  context.arc(size / 2, size / 2, scale * reach, 0, 2 * Math.PI);
  context.moveTo(x(-reach), size / 2); context.lineTo(x(reach), size / 2);
  context.moveTo(size / 2, y(reach)); context.lineTo(size / 2, y(-reach));
  context.stroke();
  for (const [index, at] of [["d", [x(reach) + 6, size / 2 + 5]], ["q", [size / 2 - 5, y(reach) - 12]]]) {
    context.fillText("i", ...at);
    context.fillText(index, at[0] + 4, at[1] + 4);
  }
  context.fillText(radius, x(0.74 * reach), y(0.76 * reach));
  return { context, x, y };
}

/** Draw points (x, y, sigma, series) with bars of two standard errors on either side, a line for each series. */
function drawTrend(points, label, describe, tick) {
  const [width, height, left, bottom, top] = [600, 250, 78, 34, 24];
  const bar = (p) => 2 * (p.sigma ?? 0);
  const [low, high] = [Math.min(...points.map((p) => p.y - bar(p))), Math.max(...points.map((p) => p.y + bar(p)))];
  const pad = 0.08 * (high - low) || 0.01 * Math.abs(high) || 1;
  const [first, last] = [Math.min(...points.map((p) => p.x)), Math.max(...points.map((p) => p.x))];
  const x = (value) => left + 50 + (width - left - 106) * (last > first ? (value - first) / (last - first) : 0.5);
  const y = (value) => height - bottom - (height - bottom - top) * (value - low + pad) / (high - low + 2 * pad);
  const ordered = [...points].sort((a, b) => a.x - b.x);
  const svg = made("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", role: "img", "aria-label": `${label}: ${points.length} points` },
    made("text", { x: left, y: 15 }, ...symbol(label, "tspan")),
    made("rect", { class: "frame", x: left, y: top, width: width - left - 6, height: height - bottom - top }));
  const colours = ["var(--d)", "var(--q)", "var(--good)", "var(--grey)"];
  const series = [...new Set(points.map((p) => p.series))];
  series.forEach((name, n) => {
    const [own, stroke] = [ordered.filter((p) => p.series === name), colours[n % colours.length]];
    for (const parts of [own.map((p, k) => `${k ? "L" : "M"}${x(p.x)} ${y(p.y)}`), own.map((p) => `M${x(p.x)} ${y(p.y - bar(p))}V${y(p.y + bar(p))}`)]) {
      svg.append(made("path", { class: "line", d: parts.join(""), style: `stroke: ${stroke}` }));
    }
    for (const p of own) svg.append(made("circle", { cx: x(p.x), cy: y(p.y), r: 3.5, style: `fill: ${stroke}` }, made("title", {}, describe(p))));
    if (series.length > 1) svg.append(made("text", { x: width - 8 - 70 * (series.length - 1 - n), y: 15, "text-anchor": "end", style: `fill: ${stroke}` }, name));
  });
  const least = (high - low + 2 * pad) / 6;
  const step = [1, 2, 5, 10].map((factor) => factor * 10 ** Math.floor(Math.log10(least))).find((round) => round >= least);
  for (let n = Math.ceil((low - pad) / step); n * step <= high + pad; n += 1) {
    const written = (n * step).toFixed(Math.max(0, -Math.floor(Math.log10(step)))).replace("-", "\u2212");
    svg.append(made("path", { class: "frame", d: `M${left} ${y(n * step)}h-5` }), made("text", { x: left - 8, y: y(n * step) + 4, "text-anchor": "end" }, written));
  }
  const ticks = last > first ? [first, (first + last) / 2, last] : [first];
  for (const [n, value] of ticks.entries()) {
    svg.append(made("path", { class: "frame", d: `M${x(value)} ${height - bottom}v5` }), made("text", { x: x(value), y: height - 10, "text-anchor": n === 2 ? "end" : n || ticks.length < 2 ? "middle" : "start" }, tick(value)));
  }
  return svg;
}
