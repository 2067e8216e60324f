"use strict";
/* Courses over time: kept in a limited number of points, drawn on a canvas. No text of a run becomes markup here. */

const MOST_POINTS = 1200;
const SPARSE_GAP_S = 60; /* predictions are at most this far apart where a line joins them */
const STATE_S = 1; /* the panel sends a state so often */
const PACE_STATES = 10; /* states over which the pace of a run is measured */

/* Rig time that passes between two states, s: a run may go on faster than real time. `heard` has [ms, rig time] of the last states. */
function stateStep(heard) {
  if (heard.length < 2) return STATE_S;
  const [[ms0, t0], [ms1, t1]] = [heard[0], heard[heard.length - 1]];
  return Math.max(STATE_S, (1000 * STATE_S * (t1 - t0)) / Math.max(ms1 - ms0, 1000));
}

/* Series of one plot over a common time axis. A point has mean, low and high of each series; points of one bin merge. */
class Course {
  constructor(document_, periodS) {
    this.binS = document_.bin_s;
    this.periodS = periodS;
    this.stateS = STATE_S;
    this.newestS = -Infinity;
    this.time = document_.time_s.slice();
    this.count = this.time.map(() => 1);
    this.series = new Map();
    for (const [name, cells] of Object.entries(document_.series)) {
      this.series.set(name, { mean: cells.mean.slice(), low: cells.low.slice(), high: cells.high.slice() });
    }
  }

  add(timeS, values) {
    const last = this.time.length - 1;
    const merges = last >= 0 && Math.floor(timeS / this.binS) === Math.floor(this.time[last] / this.binS);
    /* The state of a run that has ended is sent again and again: it is one point. */
    if (timeS <= this.newestS || (last >= 0 && timeS < this.time[last] - this.binS)) return;
    this.newestS = timeS;
    if (!merges) {
      this.time.push(timeS);
      this.count.push(0);
      for (const cells of this.series.values()) for (const kept of Object.values(cells)) kept.push(null);
    }
    const at = this.time.length - 1;
    const weight = ++this.count[at];
    for (const [name, cells] of this.series) {
      const value = values[name];
      if (value === null || value === undefined) continue;
      cells.mean[at] = cells.mean[at] === null ? value : cells.mean[at] + (value - cells.mean[at]) / weight;
      cells.low[at] = cells.low[at] === null ? value : Math.min(cells.low[at], value);
      cells.high[at] = cells.high[at] === null ? value : Math.max(cells.high[at], value);
    }
    if (this.time.length > MOST_POINTS) this.halve();
  }

  /* No line joins points that are farther apart: there are no rows between them. */
  gapS() { return 3 * Math.max(this.binS, this.periodS, this.stateS); }

  halve() {
    this.binS *= 2;
    const keep = (array, pick) => array.filter((_, k) => k % 2 === 0).map((one, k) => pick(one, array[2 * k + 1]));
    const mean = (a, b) => (b === undefined || b === null ? a : a === null ? b : (a + b) / 2);
    const least = (a, b) => (b === undefined || b === null ? a : a === null ? b : Math.min(a, b));
    const most = (a, b) => (b === undefined || b === null ? a : a === null ? b : Math.max(a, b));
    this.time = keep(this.time, mean);
    this.count = this.time.map(() => 1);
    for (const cells of this.series.values()) {
      cells.mean = keep(cells.mean, mean);
      cells.low = keep(cells.low, least);
      cells.high = keep(cells.high, most);
    }
  }
}

function niceStep(span, count) {
  const rough = span / Math.max(count, 1);
  const power = Math.pow(10, Math.floor(Math.log10(rough)));
  return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough);
}

function timeStep(spanS, count) {
  const steps = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 21600, 43200, 86400, 172800];
  return steps.find((step) => step >= spanS / count) || 604800;
}

function clock(seconds) {
  const s = Math.max(0, Math.round(seconds));
  const two = (n) => String(n).padStart(2, "0");
  return `${Math.floor(s / 3600)}:${two(Math.floor(s / 60) % 60)}:${two(s % 60)}`;
}

/* Draw the curves ({name, label, color, band, dash}) of a course from `fromS` on; `atS` marks a time, or is null. */
function drawCourse(canvas, course, curves, fromS, atS) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !height) return;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, 'Liberation Sans', sans-serif";
  const first = course.time.findIndex((t) => t >= fromS);
  if (first < 0) return;
  let low = Infinity, high = -Infinity;
  for (const curve of curves) {
    const cells = course.series.get(curve.name);
    if (!cells) continue;
    for (let k = first; k < course.time.length; k++) {
      if (cells.low[k] !== null && cells.low[k] < low) low = cells.low[k];
      if (cells.high[k] !== null && cells.high[k] > high) high = cells.high[k];
    }
  }
  const inks = getComputedStyle(document.documentElement), ink = (name) => (name.startsWith("--") ? inks.getPropertyValue(name).trim() : name);
  if (low > high) { pen.fillStyle = ink("--soft"); pen.fillText("no good value yet", 8, 20); return; }
  const pad = Math.max((high - low) * 0.06, Math.abs(high) * 1e-3, 0.05);
  low -= pad; high += pad;
  const t0 = Math.max(fromS, course.time[first]), t1 = Math.max(course.time[course.time.length - 1], t0 + 1);
  const step = niceStep(high - low, 4);
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  const labels = [];
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) labels.push([v, v.toFixed(digits)]);
  const left = Math.max(...labels.map(([, text]) => pen.measureText(text).width), 20) + 8;
  const right = width - 6, top = 6, bottom = height - 20;
  const x = (t) => left + ((t - t0) / (t1 - t0)) * (right - left);
  const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
  pen.lineWidth = 1; pen.strokeStyle = ink("--rail"); pen.fillStyle = ink("--soft"); pen.textBaseline = "middle"; pen.textAlign = "right";
  for (const [v, text] of labels) {
    pen.beginPath(); pen.moveTo(left, Math.round(y(v)) + 0.5); pen.lineTo(right, Math.round(y(v)) + 0.5); pen.stroke();
    pen.fillText(text, left - 5, y(v));
  }
  pen.textBaseline = "alphabetic"; pen.textAlign = "center";
  const each = timeStep(t1 - t0, Math.max(2, Math.floor((right - left) / 75)));
  for (let t = Math.ceil(t0 / each) * each; t <= t1; t += each) {
    const half = pen.measureText(clock(t)).width / 2;
    pen.fillText(clock(t), Math.min(Math.max(x(t), left + half), right - half), height - 5);
  }
  pen.save(); pen.beginPath(); pen.rect(left, top, right - left, bottom - top); pen.clip();
  for (const curve of curves) {
    const cells = course.series.get(curve.name);
    if (!cells) continue;
    if (curve.band) {
      pen.fillStyle = ink(curve.band);
      for (let k = first; k < course.time.length; k++) {
        if (cells.low[k] === null || k + 1 >= course.time.length) continue;
        const size = Math.max(1, y(cells.low[k]) - y(cells.high[k]));
        const until = Math.min(course.time[k + 1], course.time[k] + 2 * course.binS);
        if (size > 1.5) pen.fillRect(x(course.time[k]), y(cells.high[k]), Math.max(1, x(until) - x(course.time[k])), size);
      }
    }
    pen.strokeStyle = ink(curve.color); pen.lineWidth = curve.width || 1.6; pen.setLineDash(curve.dash || []);
    pen.beginPath();
    let drawn = false, before = null;
    for (let k = first; k < course.time.length; k++) {
      if (k > first && course.time[k] - course.time[k - 1] > course.gapS()) drawn = false;
      if (cells.mean[k] === null) { drawn = curve.sparse ? drawn : false; continue; }
      if (drawn && curve.sparse && course.time[k] - before > Math.max(SPARSE_GAP_S, 4 * course.binS)) drawn = false;
      if (drawn) pen.lineTo(x(course.time[k]), y(cells.mean[k])); else pen.moveTo(x(course.time[k]), y(cells.mean[k]));
      drawn = true; before = course.time[k];
    }
    pen.stroke(); pen.setLineDash([]);
  }
  if (atS !== null && atS >= t0 && atS <= t1) {
    pen.strokeStyle = ink("--cursor"); pen.lineWidth = 1; pen.beginPath(); pen.moveTo(x(atS), top); pen.lineTo(x(atS), bottom); pen.stroke();
  }
  pen.restore();
  canvas.axis = { left, right, t0, t1 };
}
