(() => {
  const SILENT = 5000;  // ms without news after which the page says so
  const MOST_POINTS = 20000;
  let state = { points: [] };
  let heard = null;
  let drawn = true;
  let reach = 0;  // i_max, A, also while the drive is idle
  let mapAt = null;  // when the map came, ms

  function tile(id, value, meaning, level) {
    const [, shownValue, shownMeaning] = byId(id).children;
    [shownValue.textContent, shownMeaning.textContent] = [value, meaning];
    if (level) byId(id).className = level;
  }

  const measured = ([value, sigma, unit]) => {
    if (value === null) return "unknown";
    if (!sigma) return `${shown(value, 5)} ${unit}`;
    const digits = Math.max(0, 1 - Math.floor(Math.log10(sigma)));
    return `${value.toFixed(digits)} ± ${sigma.toFixed(digits)} ${unit}`.replace("-", "\u2212");
  };

  function showStates() {
    const { publisher, drive, speed } = state;
    if (publisher) {
      const elapsed = finished() ? publisher.duration : publisher.elapsed;
      const course = Number.isFinite(publisher.duration) && publisher.duration > 0 ? `${shown(elapsed)} of ${shown(publisher.duration)} s` : `${shown(publisher.elapsed)} s`;
      tile("publisher", finished() ? "finished" : publisher.state.replace("_", " "), [course, publisher.dry_run ? "dry run" : "", publisher.reason].filter(Boolean).join("; "),
        publisher.state === "tripped" ? "weak" : publisher.state === "idle" && !finished() ? "unknown" : "good");
    }
    if (drive) {
      const known = [[(speed ?? drive.speed) * 30 / Math.PI, "rpm electrical"], [drive.dc_link_voltage, "V"], [drive.winding_temperature, "°C winding"]];
      tile("drive", drive.fault ? "fault" : drive.enabled ? "enabled" : "not enabled",
        [drive.fault, ...known.filter(([value]) => Number.isFinite(value)).map(([value, unit]) => `${shown(value)} ${unit}`)].filter(Boolean).join("; "),
        drive.fault ? "weak" : drive.enabled ? "good" : "unknown");
    }
    const trouble = [publisher?.state === "tripped" ? `The publisher tripped: ${publisher.reason}` : "", drive?.fault ?? ""].filter(Boolean);
    byId("safety").hidden = !trouble.length;
    if (byId("safety").textContent !== trouble.join(" ")) byId("safety").textContent = trouble.join(" ");
  }

  const provisional = () => `provisional, ${Math.round((Date.now() - mapAt) / 1000)} s old`;
  const held = () => state.map && !state.map.provisional && (state.publisher?.state ?? "idle") === "idle";  // the requested fit
  const finished = () => held() || (state.publisher?.state === "idle" && state.publisher.completed);

  function showEstimates() {
    const { resistance, map } = state;
    const last = resistance?.estimates.at(-1);
    if (last && state.from !== "request") tile("R", measured([...last.slice(1), resistance.unit]), `from ${last[0]} samples`);
    else if (map) tile("R", measured(map.resistance), "of the requested fit");
    if (map) {
      tile("psi", measured(map.psi_pm), map.provisional ? provisional() : "of the requested fit");
      tile("drop", measured(map.drop), `method ${map.method}`);
    }
    byId("forecast").textContent = state.from === "request" ? "" : resistance?.forecast ?? "";
    const points = (resistance?.estimates ?? []).filter((e) => e[2] !== null).map(([samples, y, sigma]) => ({ x: samples, y, sigma, series: "" }));
    if (points.length > 1) byId("course").replaceChildren(drawTrend(points, `R / ${resistance.unit} over the samples, bars: ±2 σ`, (p) => measured([p.y, p.sigma, resistance.unit]), (samples) => String(Math.round(samples))));
  }

  function showList(id, found) {
    const sentences = found.length ? found : ["None."];
    const now = [...byId(id).children].map((item) => item.textContent);
    if (now.join("\n") !== sentences.join("\n")) byId(id).replaceChildren(...sentences.map((sentence) => made("li", {}, sentence)));
  }

  function showSentences() {
    const nodes = Object.entries(state.nodes ?? {});
    const said = nodes.filter(([, node]) => node.level > 0).map(([name, node]) => `${name}: ${node.message}`);
    showList("warning-list", [...(state.silent ?? []), ...(state.map?.warnings ?? []), ...said, ...(state.feed ? [state.feed] : [])]);
    showList("node-list", nodes.map(([name, node]) => `${name}: ${node.message}`));
  }

  function showDisc() {
    const { points, map } = state;
    reach = map?.i_max ?? state.i_max ?? Math.max(reach, 1.05 * points.reduce((most, [d, q]) => Math.max(most, Math.hypot(d, q)), 0));
    const values = map ? map.sigma.map((value) => Math.log10(Math.max(value, 1e-12))) : [];
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const { context, x, y } = drawDisc(byId("disc"), reach || 1, map?.cells ?? [], map?.step ?? 1, values, (v) => shade(high > low ? (v - low) / (high - low) : 0), reach ? `${shown(reach, 4)} A` : "");
    context.strokeStyle = "#d5482a";
    context.lineWidth = 0.8;
    context.beginPath();
    points.forEach(([d, q], n) => context[n ? "lineTo" : "moveTo"](x(d), y(q)));
    context.stroke();
    if (points.length) {
      context.fillStyle = "#d5482a";
      context.beginPath();
      context.arc(x(points.at(-1)[0]), y(points.at(-1)[1]), 5, 0, 2 * Math.PI);
      context.fill();
    }
    if (!map) return;
    byId("disc-bar").replaceChildren(colourBar(`${shown(10 ** low, 2)} ${map.psi_pm[2]}`, `${shown(10 ** high, 2)} ${map.psi_pm[2]}`, false));
    byId("disc-caption").textContent = `Measured currents; cells: the larger standard error of both fluxes, hatched: no data; ${shown(100 * map.coverage)} % of the disc has data.`;
  }

  function draw() {
    drawn = true;
    for (const act of [showStates, showEstimates, showSentences, showDisc]) act();
    document.documentElement.dataset.points = state.points.length;
  }

  function take(news) {
    if (news.reset) state = { points: [] };
    const points = [...state.points, ...(news.points ?? [])].slice(-MOST_POINTS);
    const samples = news.resistance?.estimates.at(-1)?.[0] ?? state.samples;
    const from = news.map && !news.map.provisional ? "request" : samples !== state.samples && !held() ? "background" : state.from;
    Object.assign(state, news, { points, samples, from });
    heard = Date.now();
    if (news.map) mapAt = heard;
    if (drawn) { drawn = false; requestAnimationFrame(draw); }
  }

  const source = new EventSource("events");
  let connected = false;
  source.onmessage = (event) => take(JSON.parse(event.data));
  source.onopen = () => { connected = true; };
  source.onerror = () => { connected = false; };
  setInterval(() => {
    const age = Date.now() - heard;
    const said = !connected ? "The server does not answer; this page shows what it knew last."
      : finished() ? "Finished: these are the values of the requested fit." : age > SILENT ? `No news for ${Math.round(age / 1000)} s.` : state.nodes || state.drive ? "Following the drive." : "Connected; nothing is heard of a drive yet.";
    if (byId("link").textContent !== said) byId("link").textContent = said;
    if (state.map?.provisional) byId("psi").lastElementChild.textContent = provisional();
  }, 500);
  dark.addEventListener("change", () => { applyTheme(); draw(); });
  draw();
})();
