// Drift and residuals, drawn by uPlot: seen minus believed over the night, and what the last plate leaves of its stars.

import { by, colors, element, fill, MONO, say } from "./elements.js";
import { small } from "./angles.js";

// steps of an axis of seconds of arc that people count in
const STEPS_ARCSEC = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 72000, 180000, 360000];
const LEGEND_PX = 30;

export function showPlots(observatory) {
  const drift = plotIn(by("drift-plot"), "");
  const residuals = plotIn(by("residual-plot"), "");

  function showDrift() {
    const { offsets } = observatory;
    const looks = offsets?.looks ?? [];
    drift(looks.length ? driftData(looks) : null, (color) => driftOptions(color, offsets));
    const last = looks.at(-1);
    by("drift-plot").setAttribute("aria-label", last
      ? `Drift of ${looks.length} looks; the last one saw the tube ${small(last.east_arcsec, true)} east and ${small(last.north_arcsec, true)} north of where the mount believed it`
      : "Drift: no looks");
  }

  function showResiduals() {
    const frame = observatory.frame;
    const stars = (frame?.stars ?? []).filter((one) => one.east_arcsec !== null && one.mag !== null);
    const line = (observatory.offsets?.looks ?? []).filter((one) => one.residual_east_arcsec !== null);
    // looks about their stretch's line tell of the mount; where there are none, the stars tell of the plate
    const ofLooks = line.length >= 3;
    say(by("residuals-note"), ofLooks ? "looks about the straight drift of their stretch" : "stars of the last frame by magnitude");
    const data = ofLooks
      ? [line.map((one) => Date.parse(one.utc) / 1000), line.map((one) => one.residual_east_arcsec), line.map((one) => one.residual_north_arcsec)]
      : starData(stars);
    residuals(data[0].length ? data : null, (color) => residualOptions(color, ofLooks));
    const rms = (column) => Math.sqrt(column.reduce((sum, one) => sum + one * one, 0) / column.length);
    const unsolved = frame && !frame.solved ? `The last frame was not solved: ${frame.reason}` : "";
    const words = !data[0].length ? unsolved : data[0].length === 1 ? `one ${ofLooks ? "look" : "star"}` : `rms ${rms(data[1]).toPrecision(2)}″ east, ${rms(data[2]).toPrecision(2)}″ north, ${data[0].length} ${ofLooks ? "looks" : "stars"}`;
    say(by("residual-words"), words);
    by("residual-plot").setAttribute("aria-label", `Residuals: ${words || "none"}`);
  }
  observatory.on("offsets", showDrift);
  observatory.on("offsets", showResiduals);
  observatory.on("frame", showResiduals);
  showDrift();
  showResiduals();
  return () => {
    drift.again();
    residuals.again();
  };
}

/** Columns with a hole where a stretch ends, so that no line is drawn over a move or a sync. */
export function driftData(looks) {
  const columns = [[], [], []];
  looks.forEach((one, i) => {
    const t = Date.parse(one.utc) / 1000;
    if (i && looks[i - 1].stretch !== one.stretch) {
      columns[0].push(t - 1e-3);
      columns[1].push(null);
      columns[2].push(null);
    }
    columns[0].push(t);
    columns[1].push(one.east_arcsec);
    columns[2].push(one.north_arcsec);
  });
  return columns;
}

function starData(stars) {
  const sorted = [...stars].sort((a, b) => a.mag - b.mag);
  return [sorted.map((one) => one.mag), sorted.map((one) => one.east_arcsec), sorted.map((one) => one.north_arcsec)];
}

const DECADES = [1, 10, 60, 600, 3600, 36000];

/** Marks of an axis that is logarithmic far out. */
const decades = (_plot, _axis, low, high) => [...DECADES.map((one) => -one).reverse(), 0, ...DECADES].filter((one) => low <= one && one <= high);

/** Only marks that stand apart, from 0 outwards. */
function apart(plot, ticks) {
  const shown = new Set([0]), place = (t) => plot.valToPos(t, "y");
  for (const side of [ticks.filter((t) => t > 0), ticks.filter((t) => t < 0).reverse()]) {
    let last = place(0);
    for (const t of side) {
      if (Math.abs(place(t) - last) < 15) continue;
      last = place(t);
      shown.add(t);
    }
  }
  return ticks.map((t) => (shown.has(t) ? t : null));
}

function angle(t) {
  if (t === null) return "";
  const size = Math.abs(t), mark = t < 0 ? "−" : "";
  if (size >= 3600) return `${mark}${+(size / 3600).toPrecision(3)}°`;
  return size >= 60 ? `${mark}${+(size / 60).toPrecision(3)}′` : `${mark}${+size.toPrecision(3)}″`;
}

function axes(color, time, wide = false) {
  const one = { stroke: color.dim, font: MONO, grid: { stroke: color.grid, width: 1 }, ticks: { stroke: color.grid, width: 1, size: 4 } };
  const values = time
    ? (_, ticks) => ticks.map((t) => t === null ? "" : new Date(t * 1000).toISOString().slice(11, 19).replace(/:00$/, ""))
    : (_, ticks) => ticks.map((t) => `${t}ᵐ`);
  return [
    { ...one, values, space: 70, size: 28 },
    { ...one, size: 62, ...(wide ? { splits: decades, filter: apart } : { incrs: STEPS_ARCSEC, space: 26 }), values: (_, ticks) => ticks.map(angle) },
  ];
}

const number = (_, value) => (value === null || value === undefined ? "–" : small(value, true));

function series(color, lines) {
  const points = { show: true, size: 5, width: 1 };
  return [
    ["east", color.east], ["north", color.north],
  ].map(([label, stroke]) => ({
    label, stroke, width: lines ? 1.4 : 0, value: number, spanGaps: false, paths: lines ? undefined : () => null,
    points: { ...points, stroke, fill: stroke },
  }));
}

function driftOptions(color, offsets) {
  const wide = wideScale(offsets.looks);
  return {
    cursor: { y: false }, axes: axes(color, true, Boolean(wide.distr)), scales: { x: { time: true, range: spread(120) }, y: wide.distr ? wide : { range: spread(2) } },
    series: [{ label: "UTC", value: (_, t) => (t === null ? "–" : new Date(t * 1000).toISOString().slice(11, 19)) }, ...series(color, true)],
    hooks: { drawClear: [(plot) => moments(plot, (offsets?.slew_ends ?? []).map((one) => Date.parse(one) / 1000), color.line)] },
  };
}

/** Straight, unless a few looks lie so far off that all others would be one line: then linear near 0, logarithmic far out. */
function wideScale(looks) {
  const sizes = looks.flatMap((one) => [Math.abs(one.east_arcsec), Math.abs(one.north_arcsec)]).sort((a, b) => a - b);
  const middle = Math.max(5, sizes[sizes.length >> 1]);
  return sizes.at(-1) > 20 * middle ? { distr: 4, asinh: middle } : {};
}

function residualOptions(color, time) {
  const first = time
    ? { label: "UTC", value: (_, t) => (t === null ? "–" : new Date(t * 1000).toISOString().slice(11, 19)) }
    : { label: "mag", value: (_, m) => (m === null ? "–" : m.toFixed(1)) };
  return { cursor: { y: false }, axes: axes(color, time), scales: { x: { time, range: spread(time ? 120 : 1) }, y: { range: spread(0.5) } }, series: [first, ...series(color, false)] };
}

/** A range that a single value gets room in, and none lies on the edge. */
const spread = (least) => (_plot, low, high) => {
  if (low === null || high === null) return [0, least];
  const room = Math.max(0.06 * (high - low), (least - (high - low)) / 2, 0);
  return [low - room, high + room];
};

function moments(plot, times, stroke) {
  const c = plot.ctx, { top, height, left, width } = plot.bbox;
  c.save();
  c.strokeStyle = stroke;
  c.setLineDash([3, 4]);
  for (const t of times) {
    const x = Math.round(plot.valToPos(t, "x", true));
    if (x < left || x > left + width) continue;
    c.beginPath();
    c.moveTo(x, top);
    c.lineTo(x, top + height);
    c.stroke();
  }
  c.restore();
}

const heightOf = (box) => Math.max(90, box.clientHeight - LEGEND_PX);

function plotIn(box, empty) {
  let plot = null, last = [null, null];
  function show(data, options) {
    last = [data, options];
    if (!data) {
      plot?.destroy();
      plot = null;
      fill(box, element("div", { class: "empty" }, empty));
      return;
    }
    const width = box.clientWidth;
    if (width < 50) return;
    plot?.destroy();
    fill(box);
    plot = new window.uPlot({ width, height: heightOf(box), ...options(colors()) }, data, box);
    plot.root.querySelector(".u-legend")?.setAttribute("aria-label", "Values under the pointer");
  }
  show.again = () => show(...last);
  new ResizeObserver(() => {
    const changed = plot && (Math.abs(plot.width - box.clientWidth) > 1 || Math.abs(plot.height - heightOf(box)) > 1);
    if (changed && box.clientWidth > 50) plot.setSize({ width: box.clientWidth, height: heightOf(box) });
    else if (!plot && last[0]) show.again();
  }).observe(box);
  return show;
}
