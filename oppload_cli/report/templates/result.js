"use strict";
(() => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const rows = data.frames.length;
  const time = data.time;
  const stage = byId("stage");
  const video = byId("video");
  const canvas = byId("boxes");
  const slider = byId("slider");
  const exact = "requestVideoFrameCallback" in video;
  let row = 0; // the row that the curves and the values show
  let presented = 0; // the row of the picture on the screen
  let playable = false;

  // --- The video -------------------------------------------------------------------------------

  const inVideo = []; // rows whose frame the video holds
  if (data.video) data.video.times.forEach((t, r) => t !== null && inVideo.push(r));

  /** The position in a list of the last element with a time of at most t; 0 if there is none. */
  function lastUpTo(list, timeOf, t) {
    let low = 0;
    let high = list.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (timeOf(list[middle]) <= t) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** The row that the video shows at a time. */
  const shownAt = (t) => inVideo[lastUpTo(inVideo, (r) => data.video.times[r], t + 1e-5)];

  /** The row with the time nearest to t. */
  const all = data.frames.map((_, r) => r);
  function rowNear(t) {
    const r = lastUpTo(all, (each) => time[each], t);
    return r + 1 < rows && time[r + 1] - t < t - time[r] ? r + 1 : r;
  }

  /** The middle of the time in which the video shows a row: rounding leads to no other frame. */
  function middleOf(r) {
    const start = data.video.times[r];
    if (start === null) return null;
    const next = inVideo[lastUpTo(inVideo, (each) => each, r) + 1];
    const end = next === undefined ? video.duration : data.video.times[next];
    return end > start ? (start + end) / 2 : start;
  }

  let waiting = null; // time of the next seek, while the video still seeks another time
  function seek(r) {
    if (!playable) {
      present(r);
      return;
    }
    const t = middleOf(r);
    if (t === null) return;
    if (video.seeking) waiting = t;
    else video.currentTime = t;
  }

  function onFrame(_, about) {
    present(shownAt(about.mediaTime));
    if (!video.paused) show(presented);
    video.requestVideoFrameCallback(onFrame);
  }

  function follow() {
    if (video.paused) return;
    present(shownAt(video.currentTime));
    show(presented);
    requestAnimationFrame(follow);
  }

  function withoutVideo(sentence) {
    playable = false;
    video.hidden = byId("play").hidden = byId("speed").hidden = true;
    byId("message").textContent = sentence;
    byId("message").hidden = false;
    present(row);
  }

  function address() {
    const film = byId("film");
    if (!film) return data.video.address;
    const text = atob(film.textContent);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
    film.remove();
    return URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
  }

  function load() {
    if (!data.video) {
      withoutVideo("The page has no video; the remarks say why.");
      return;
    }
    video.addEventListener("loadedmetadata", () => {
      playable = true;
      stage.dataset.playable = "1";
      seek(row);
    });
    video.addEventListener("error", () =>
      withoutVideo(
        data.video.address === null
          ? "This browser cannot play the video (H.264)."
          : `The video cannot be played; is ${data.video.name} still beside the page?`,
      ),
    );
    video.addEventListener("seeked", () => {
      if (waiting !== null) {
        video.currentTime = waiting;
        waiting = null;
      } else present(shownAt(video.currentTime));
    });
    video.addEventListener("play", () => {
      byId("play").textContent = "Pause";
      if (!exact) follow();
    });
    video.addEventListener("pause", () => {
      byId("play").textContent = "Play";
      // Seek the frame on the screen: the video's clock may already be at the next frame.
      if (!video.seeking) go(video.ended ? shownAt(video.duration) : presented);
    });
    if (exact) video.requestVideoFrameCallback(onFrame);
    video.src = address();
  }

  function toggle() {
    if (!playable) return;
    if (!video.paused) video.pause();
    else {
      if (row === rows - 1) go(0);
      video.playbackRate = Number(byId("speed").value);
      video.play();
    }
  }

  // --- Boxes -----------------------------------------------------------------------------------

  function present(r) {
    presented = r;
    stage.dataset.presented = r;
    const width = Math.round(stage.clientWidth * devicePixelRatio);
    const height = Math.round(stage.clientHeight * devicePixelRatio);
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    const boxes = data.boxes[r] || [];
    stage.dataset.boxes = boxes.length;
    for (const box of [...boxes].reverse()) drawBox(context, box);
  }

  function drawBox(context, [x, y, w, h, cx, cy, id, alarm, contact]) {
    const across = canvas.width / data.size[0];
    const down = canvas.height / data.size[1];
    const unit = devicePixelRatio;
    const line = (alarm ? 4 : 1.5) * unit;
    const edges = [x * across, y * down, w * across, h * down];
    const paths = [() => context.strokeRect(...edges)];
    if (cx !== null) {
      paths.push(() => {
        context.beginPath();
        context.moveTo(cx * across - 6 * unit, cy * down);
        context.lineTo(cx * across + 6 * unit, cy * down);
        context.moveTo(cx * across, cy * down - 6 * unit);
        context.lineTo(cx * across, cy * down + 6 * unit);
        context.stroke();
      });
    }
    for (const [colour, extra] of [["#000", 2 * unit], [data.boxColour, 0]]) {
      context.strokeStyle = colour;
      context.lineWidth = line + extra;
      paths.forEach((path) => path());
    }
    const words = [];
    if (id !== null) words.push(`#${id}`);
    if (alarm) words.push("alarm");
    if (contact !== null) words.push(`contact in ${contact.toFixed(contact < 1 ? 2 : 1)} s`);
    if (!words.length) return;
    const text = words.join("  ");
    context.font = `600 ${12 * unit}px system-ui, sans-serif`;
    const wide = context.measureText(text).width + 10 * unit;
    const left = Math.max(0, Math.min(edges[0], canvas.width - wide));
    const top = edges[1] >= 20 * unit ? edges[1] - 18 * unit : Math.max(0, edges[1]);
    context.fillStyle = data.boxColour;
    context.fillRect(left, top, wide, 18 * unit);
    context.fillStyle = data.boxInk;
    context.textBaseline = "middle";
    context.fillText(text, left + 5 * unit, top + 9.5 * unit);
  }

  // --- Curves ----------------------------------------------------------------------------------

  const LOWEST = 0.01; // of the threshold, on the logarithmic axis
  const charts = [];
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const steps = time.slice(1).map((t, r) => t - time[r]).sort((a, b) => a - b);
  const usual = steps[steps.length >> 1] || 0;
  // A frame lasts until the next one, but at most two usual steps: frames may be missing.
  const endOf = (r) => (r + 1 < rows ? Math.min(time[r + 1], time[r] + 2 * usual) : time[r]);

  function shade(u, first, last, colour, opacity, height) {
    const left = u.valToPos(time[first], "x", true);
    const right = Math.max(u.valToPos(endOf(last), "x", true), left + devicePixelRatio);
    const { ctx, bbox } = u;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.globalAlpha = opacity;
    ctx.fillStyle = lifted(colour);
    ctx.fillRect(left, bbox.top + height[0], right - left, height[1] - height[0]);
    ctx.restore();
  }

  function mark(u, scale, value, label, dash) {
    const { ctx, bbox } = u;
    const at = u.valToPos(value, scale, true);
    const sideways = scale !== "x";
    const [low, high] = sideways
      ? [bbox.top, bbox.top + bbox.height]
      : [bbox.left, bbox.left + bbox.width];
    if (!(at >= low && at <= high)) return;
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = css("--ink");
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash(dash.map((each) => each * devicePixelRatio));
    ctx.beginPath();
    ctx.moveTo(sideways ? bbox.left : at, sideways ? at : bbox.top);
    ctx.lineTo(sideways ? bbox.left + bbox.width : at, sideways ? at : bbox.top + bbox.height);
    ctx.stroke();
    ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    const gap = 4 * devicePixelRatio;
    if (sideways) {
      ctx.textAlign = "left";
      ctx.fillText(label, bbox.left + gap, at - gap);
    } else {
      const left = at < bbox.left + bbox.width / 2;
      ctx.textAlign = left ? "left" : "right";
      ctx.fillText(label, at + (left ? gap : -gap), bbox.top + bbox.height - gap);
    }
    ctx.restore();
  }

  /** Add a panel: its curves are {label, colour, values, alarms}. */
  function panel(title, height, curves, scale, ticks, below) {
    const heading = element("h2", {}, title);
    curves.forEach((curve, order) => {
      const look = { type: "button", class: "names", title: "Show or hide this curve", "aria-pressed": true };
      const name = element("button", look, key(curve.colour), ` ${curve.label}`);
      name.addEventListener("click", () => {
        const shown = !u.series[order + 1].show;
        name.setAttribute("aria-pressed", shown);
        u.setSeries(order + 1, { show: shown });
      });
      heading.append(name);
    });
    const names = curves.map((curve) => curve.label).join(", ");
    const host = element("div", { class: "chart", role: "img", "aria-label": `${title} over time: ${names}` });
    byId("charts").append(heading, host);
    const line = { stroke: () => css("--dim"), font: "11px system-ui, sans-serif" };
    const grid = { stroke: () => css("--line"), width: 1 };
    const options = {
      width: Math.max(200, host.clientWidth),
      height,
      padding: [6, 10, 0, 0],
      legend: { show: false },
      cursor: {
        y: false,
        points: { show: false },
        drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => zoom(time[0], time[rows - 1]) },
      },
      scales: { x: { time: false, range: () => range }, y: scale },
      axes: [
        { ...line, grid, ticks: { show: false }, size: 22, gap: 3 },
        { ...line, grid, ticks: { show: false }, size: 48, ...ticks },
      ],
      series: [
        {},
        ...curves.map((curve) => ({
          stroke: () => lifted(curve.colour),
          width: 1.6,
          points: { show: false },
          spanGaps: false,
        })),
      ],
      hooks: {
        drawClear: [(u) => ground(u, curves)],
        draw: [(u) => below(u)],
        setSelect: [select],
      },
    };
    const values = curves.map((curve) =>
      scale.distr === 3
        ? curve.values.map((v) => (v === null ? null : Math.max(v, LOWEST)))
        : curve.values,
    );
    const u = new uPlot(options, [time, ...values], host);
    const head = element("div", { class: "playhead" });
    u.over.append(head);
    u.over.addEventListener("click", (event) => {
      if (dragged) return;
      const box = u.over.getBoundingClientRect();
      go(rowNear(u.posToVal(event.clientX - box.left, "x")));
    });
    u.over.addEventListener("mousedown", () => {
      dragged = false;
    });
    charts.push({ u, head, host, height });
  }

  /** Shade alarms and the looming of a stimulus behind the curves. */
  function ground(u, curves) {
    const { bbox } = u;
    if (data.truth) {
      const { looming } = data.truth;
      for (let r = 0; r < rows; r += 1) {
        const first = r;
        while (r + 1 < rows && looming[first] && looming[r + 1]) r += 1;
        if (looming[first]) shade(u, first, r, "#888", 0.14, [0, bbox.height]);
      }
    }
    const strip = 5 * devicePixelRatio;
    // Bars of detectors without an alarm take no place, so that few bars lie over the curves.
    const alarmed = curves.filter((each, at) => u.series[at + 1].show && each.alarms?.length);
    alarmed.forEach((curve, order) => {
      for (const [first, last] of curve.alarms) {
        shade(u, first, last, curve.colour, 0.3 / (1 + curves.length), [0, bbox.height]);
        shade(u, first, last, curve.colour, 1, [order * strip, (order + 1) * strip]);
      }
    });
  }

  let range = [time[0], time[rows - 1]];
  let dragged = false;

  function select(u) {
    const { left, width } = u.select;
    dragged = width > 4;
    if (dragged) zoom(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
    if (width) u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  }

  function zoom(from, to) {
    const least = Math.max((time[rows - 1] - time[0]) / rows, 1e-6) * 4;
    if (to - from < least) return;
    range = [Math.max(from, time[0]), Math.min(to, time[rows - 1])];
    for (const { u } of charts) u.setScale("x", { min: range[0], max: range[1] });
    placeHeads();
  }

  /** Zoom by a factor about the current frame. */
  function zoomBy(factor) {
    const now = time[row];
    zoom(now - (now - range[0]) * factor, now + (range[1] - now) * factor);
  }

  function placeHeads() {
    // Computed from `range`, as uPlot updates its scales only later.
    const share = (time[row] - range[0]) / (range[1] - range[0]) || 0;
    for (const { head } of charts) {
      head.hidden = !(share >= 0 && share <= 1);
      head.style.left = `${100 * share}%`;
    }
  }

  /** Move the zoomed time so that it contains the current frame. */
  function keepInSight() {
    const wide = range[1] - range[0];
    if (time[row] < range[0]) zoom(time[row], time[row] + wide);
    else if (time[row] > range[1]) zoom(time[row] - wide, time[row]);
  }

  function drawCharts() {
    const over = data.curves.filter((curve) => curve.thresholded);
    const others = data.curves.filter((curve) => !curve.thresholded);
    const contact = (u, label = "") => {
      const contacts = data.truth ? data.truth.contacts : [];
      const words = label + (label && contacts.length > 1 ? "s" : "");
      contacts.forEach((at, order) => mark(u, "x", at, order ? "" : words, [4, 3]));
    };
    if (over.length) {
      const most = Math.max(10, ...over.map((c) => c.values.reduce((a, b) => Math.max(a, b), 0)));
      const top = 10 ** Math.ceil(Math.log10(most * 1.05));
      const decades = [];
      const step = top / LOWEST > 1e7 ? 100 : 10;
      for (let at = LOWEST; at <= top * 1.001; at *= step) decades.push(Number(at.toPrecision(1)));
      panel(
        "Response / threshold",
        230,
        over,
        { distr: 3, log: 10, range: () => [LOWEST, top] },
        { splits: () => decades, values: (_, splits) => splits.map((at) => (at > LOWEST ? plain(at) : `≤${plain(at)}`)) },
        (u) => {
          mark(u, "y", 1, "threshold", [4, 3]);
          contact(u);
        },
      );
    }
    if (others.length) {
      panel("Response / its peak", 150, others, { range: () => [0, 1.05] }, {}, contact);
    }
    const rmo = Object.entries(data.rmo).map(([name, values], order) => ({
      label: name === "rmo_index" ? "index" : "mean",
      colour: ["#cc79a7", "#e69f00"][order],
      values,
    }));
    if (rmo.length) {
      const splits = () => [-1, 0, 1];
      panel("Radial motion opponency", 120, rmo, { range: () => [-1.08, 1.08] }, { splits }, contact);
    }
    const sizes = data.truth ? Object.entries(data.truth.sizes) : [];
    if (sizes.length) {
      const cycle = ["#888888", "#56b4e9", "#009e73", "#cc79a7"];
      const curves = sizes.map(([label, values], order) => ({
        label,
        colour: cycle[order % cycle.length],
        values,
      }));
      const most = Math.max(...curves.map((c) => c.values.reduce((a, b) => Math.max(a, b), 0)));
      panel("Stimulus: angular size (deg)", 120, curves, { range: () => [0, most * 1.08] }, {}, (u) => contact(u, "contact"));
      const name = element("span", { class: "names" }, " ", key("#88888840"), " shaded: an object looms");
      charts.at(-1).host.previousElementSibling.append(name);
    }
    byId("charts").append(element("p", { class: "axis" }, "time (s)"));
    new ResizeObserver(() => {
      for (const { u, host, height } of charts) {
        u.setSize({ width: Math.max(200, host.clientWidth), height });
      }
    }).observe(byId("charts"));
    new ResizeObserver(() => present(presented)).observe(stage);
    matchMedia("screen and (prefers-color-scheme: dark)").addEventListener("change", () => {
      for (const { u } of charts) u.redraw();
    });
  }

  // --- Values of the frame ---------------------------------------------------------------------

  function element(tag, attributes, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }

  const key = (colour) => element("span", { class: "key", style: `background: ${colour}; background: ${mixed(colour)}` });
  const mixed = (colour) => `color-mix(in srgb, ${colour}, white var(--lift))`;

  /** A colour for a canvas, in which variables of a style have no meaning. */
  const lifted = (colour) => mixed(colour).replace("var(--lift)", css("--lift"));

  function plain(value) {
    if (value >= 100 || Number.isInteger(value)) return value.toLocaleString("en", { maximumFractionDigits: 0 });
    return Number(value.toPrecision(2)).toString();
  }

  /** A response as text; below 1 it does not become 1. The axis shows no values below LOWEST. */
  function size(value) {
    if (value > 0 && value < LOWEST) return `< ${LOWEST}`;
    return plain(value < 1 ? Math.min(value, 0.99) : value);
  }

  function clock(seconds) {
    const t = Number(seconds.toFixed(2)); // before the minutes are taken, so that no seconds are 60.00
    if (t < 60) return `${t.toFixed(2)} s`;
    return `${Math.floor(t / 60)}:${(t % 60).toFixed(2).padStart(5, "0")}`;
  }

  const cells = data.curves.map((curve) => {
    const line = byId("values").insertRow();
    line.append(element("th", { scope: "row" }, key(curve.colour), ` ${curve.label}`));
    return line.insertCell();
  });

  const alarmRows = [...document.querySelectorAll(".alarms tbody tr")].map((line) => ({
    line,
    first: Number(line.dataset.first),
    last: Number(line.dataset.last),
  }));

  /** Show a row in the values, the curves and the alarms, but not in the picture. */
  function show(r) {
    row = r;
    stage.dataset.row = r;
    slider.value = r;
    const now = `${clock(time[r])}, frame ${data.frames[r]}`;
    slider.setAttribute("aria-valuetext", now);
    byId("clock").textContent = now;
    data.curves.forEach((curve, order) => {
      const value = curve.values[r];
      const alarm = curve.alarms.some(([first, last]) => first <= r && r <= last);
      const unit = curve.thresholded ? "× threshold" : "of its peak";
      cells[order].className = alarm ? "on" : "";
      cells[order].textContent =
        value === null ? "no response yet" : `${size(value)} ${unit}${alarm ? ", alarm" : ""}`;
    });
    for (const { line, first, last } of alarmRows) {
      line.toggleAttribute("aria-current", first <= r && r <= last);
    }
    keepInSight();
    placeHeads();
  }

  /** Show a row, and seek its picture. */
  function go(r) {
    const target = Math.max(0, Math.min(rows - 1, r));
    if (!video.paused) video.pause();
    show(target);
    seek(target);
  }

  function goToAlarm(step) {
    const starts = [...new Set(alarmRows.map((each) => each.first))].sort((a, b) => a - b);
    const next = step > 0 ? starts.find((r) => r > row) : starts.findLast((r) => r < row);
    if (next !== undefined) go(next);
  }

  function goToHash() {
    const frame = /^#f(\d+)$/.exec(location.hash);
    if (!frame) return;
    const r = data.frames.indexOf(Number(frame[1]));
    if (r >= 0) go(r);
  }

  // --- Buttons and keys ------------------------------------------------------------------------

  const keys = {
    " ": toggle,
    ArrowLeft: (event) => go(row - (event.shiftKey ? 10 : 1)),
    ArrowRight: (event) => go(row + (event.shiftKey ? 10 : 1)),
    Home: () => go(0),
    End: () => go(rows - 1),
    n: () => goToAlarm(1),
    p: () => goToAlarm(-1),
    "+": () => zoomBy(0.5),
    "=": () => zoomBy(0.5),
    "-": () => zoomBy(2),
    0: () => zoom(time[0], time[rows - 1]),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target.tagName;
    // Buttons, links and lists use these keys themselves.
    if (event.key === " " && ["BUTTON", "SUMMARY", "A", "SELECT"].includes(target)) return;
    if (target === "SELECT" && event.key.length > 1) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event);
  });

  slider.max = rows - 1;
  slider.addEventListener("input", () => go(Number(slider.value)));
  byId("play").addEventListener("click", toggle);
  byId("back").addEventListener("click", () => go(row - 1));
  byId("on").addEventListener("click", () => go(row + 1));
  byId("previous")?.addEventListener("click", () => goToAlarm(-1));
  byId("next")?.addEventListener("click", () => goToAlarm(1));
  byId("speed").addEventListener("change", () => {
    video.playbackRate = Number(byId("speed").value);
  });
  for (const { line, first } of alarmRows) line.querySelector("button").addEventListener("click", () => go(first));
  addEventListener("hashchange", goToHash);

  drawCharts();
  show(0);
  goToHash();
  load();
})();
