"use strict";
const byId = (id) => document.getElementById(id);
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const applyTheme = () => { document.documentElement.dataset.theme = dark.matches ? "dark" : "light"; };
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
applyTheme();
document.documentElement.classList.add("interactive");

/** Make an element; text is never taken for markup. */
function made(tag, attributes = {}, ...children) {
  const svg = ["svg", "g", "path", "circle", "text", "rect", "line", "title"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

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

/** Draw cells around nodes (k_d, k_q) times a step in a disc of the current plane; returns the scale, A to pixels. */
function drawDisc(canvas, reach, cells, step, values, paint) {
  const size = canvas.width = canvas.height = 480;
  const context = canvas.getContext("2d");
  const scale = size / (2.1 * reach);
  const [x, y] = [(d) => size / 2 + scale * d, (q) => size / 2 - scale * q];
  context.save();
  context.arc(size / 2, size / 2, scale * reach, 0, 2 * Math.PI);
  context.clip();
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
  context.moveTo(0, size / 2); context.lineTo(size, size / 2);
  context.moveTo(size / 2, 0); context.lineTo(size / 2, size);
  context.stroke();
  context.fillText("i_d", size - 26, size / 2 - 6);
  context.fillText("i_q", size / 2 + 6, 14);
  context.fillText(`${shown(reach, 4)} A`, x(reach * 0.71) - 10, y(reach * 0.74));
  return { context, x, y };
}

/** Draw points (x, y, sigma) with bars of two standard errors on either side; x in ms of the epoch, or in s. */
function drawTrend(points, label, describe) {
  const [width, height, left, bottom, top] = [600, 240, 78, 34, 24];
  const bar = (p) => 2 * (p.sigma ?? 0);
  const [low, high] = [Math.min(...points.map((p) => p.y - bar(p))), Math.max(...points.map((p) => p.y + bar(p)))];
  const pad = 0.08 * (high - low) || 0.01 * Math.abs(high) || 1;
  const [first, last] = [Math.min(...points.map((p) => p.x)), Math.max(...points.map((p) => p.x))];
  const x = (value) => left + 12 + (width - left - 28) * (last > first ? (value - first) / (last - first) : 0.5);
  const y = (value) => height - bottom - (height - bottom - top) * (value - low + pad) / (high - low + 2 * pad);
  const ordered = [...points].sort((a, b) => a.x - b.x);
  const path = (parts) => made("path", { class: "line", d: parts.join("") });
  const svg = made("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", role: "img", "aria-label": `${label}: ${points.length} points` },
    made("text", { x: left, y: 15 }, label),
    made("rect", { class: "frame", x: left, y: top, width: width - left - 6, height: height - bottom - top }),
    path(ordered.map((p, n) => `${n ? "L" : "M"}${x(p.x)} ${y(p.y)}`)),
    path(ordered.map((p) => `M${x(p.x)} ${y(p.y - bar(p))}V${y(p.y + bar(p))}`)));
  for (const value of [low, (low + high) / 2, high]) svg.append(made("text", { x: left - 4, y: y(value) + 4, "text-anchor": "end" }, shown(value, 5)));
  for (const p of ordered) svg.append(made("circle", { cx: x(p.x), cy: y(p.y), r: 3.5 }, made("title", {}, describe(p))));
  svg.append(made("text", { x: left, y: height - 10 }, ordered[0].at), made("text", { x: width - 6, y: height - 10, "text-anchor": "end" }, ordered.at(-1).at));
  return svg;
}
