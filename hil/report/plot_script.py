"""Script of overlaid plots: lines on a canvas, zoom by dragging or by the wheel, back by a double click.

It reads the data blocks of its page, loads nothing, and contains no `<`, so that it fits into a page of `hil.files`.
"""

SCRIPT = """
'use strict';
(function () {
  var range = null, plots = [], FONT = '12px system-ui, sans-serif';
  function fmt(v) { return Math.abs(v) >= 1e4 ? v.toFixed(0) : String(+v.toPrecision(5)); }
  function ticks(lo, hi, n) {
    var raw = (hi - lo) / n, mag = Math.pow(10, Math.floor(Math.log10(raw))), out = [];
    var step = [1, 2, 5, 10].map(function (k) { return k * mag; }).find(function (s) { return s >= raw; });
    for (var v = Math.ceil(lo / step) * step; hi >= v; v += step) { out.push(v); }
    return out;
  }
  function Plot(block) {
    var d = this.d = JSON.parse(block.textContent), box = document.createElement('div');
    box.className = 'plotbox';
    this.canvas = document.createElement('canvas');
    this.canvas.setAttribute('role', 'img');
    this.canvas.setAttribute('aria-label', d.title);
    this.readout = document.createElement('p');
    this.readout.className = 'note';
    box.appendChild(this.canvas); box.appendChild(this.readout);
    block.parentNode.insertBefore(box, block);
    this.all = d.range; this.drag = null; this.cursor = null;
    var me = this;
    this.canvas.addEventListener('pointerdown', function (e) { me.drag = [me.at(e), me.at(e)]; });
    this.canvas.addEventListener('pointermove', function (e) {
      if (me.drag) { me.drag[1] = me.at(e); }
      plots.forEach(function (p) { p.cursor = me.at(e); p.draw(); });
    });
    window.addEventListener('pointerup', function () {
      if (!me.drag) { return; }
      var a = Math.min(me.drag[0], me.drag[1]), b = Math.max(me.drag[0], me.drag[1]), r = range || me.all;
      me.drag = null;
      if (b - a > (r[1] - r[0]) * 0.01) { range = [a, b]; }
      redraw();
    });
    this.canvas.addEventListener('pointercancel', function () { me.drag = null; });
    this.canvas.addEventListener('dblclick', function () { range = null; redraw(); });
    this.canvas.addEventListener('wheel', function (e) {
      e.preventDefault();
      var r = range || me.all, x = me.at(e), k = e.deltaY > 0 ? 1.25 : 0.8;
      range = [Math.max(me.all[0], x - (x - r[0]) * k), Math.min(me.all[1], x + (r[1] - x) * k)];
      redraw();
    }, { passive: false });
  }
  Plot.prototype.at = function (e) {
    var r = range || this.all, w = this.canvas.clientWidth - 70;
    return r[0] + (r[1] - r[0]) * Math.min(1, Math.max(0, (e.offsetX - 60) / w));
  };
  Plot.prototype.draw = function () {
    var c = this.canvas, scale = window.devicePixelRatio || 1, w = c.clientWidth, r = range || this.all;
    var g = c.getContext('2d'), lo = Infinity, hi = -Infinity, me = this;
    g.font = FONT;
    var inks = getComputedStyle(c), ink = inks.color, grid = inks.outlineColor, soft = inks.caretColor;
    // Colours of the light page that are too dark for a dark one.
    var shades = { '#30343a': ink, '#5b636b': soft, '#b3261e': inks.borderTopColor };
    function shade(colour) { return shades[colour] || colour; }
    var limits = this.d.limits || [];
    // The names stand above the curves, in as many lines as they need.
    var left = 66, line = 1, names = this.d.series.map(function (s) {
      var width = g.measureText(s.name).width;
      if (left > 66 && left + width > w - 10) { left = 66; line += 1; }
      left += width + 14;
      return [s, left - width - 14, 15 * line - 3];
    });
    var asked = limits.map(function (l) {
      var text = l.name + ' ' + l.levels.map(fmt).join(', '), width = g.measureText(text).width;
      if (left > 66 && left + width > w - 10) { left = 66; line += 1; }
      left += width + 14;
      return [text, l.colour, left - width - 14, 15 * line - 3];
    });
    var top = 15 * line + 2, h = 205 + top;
    c.style.height = h + 'px'; c.width = w * scale; c.height = h * scale;
    g.scale(scale, scale); g.font = FONT;
    this.d.series.forEach(function (s) {
      s.x.forEach(function (x, i) {
        if (x >= r[0] && r[1] >= x && s.y[i] !== null) { lo = Math.min(lo, s.y[i]); hi = Math.max(hi, s.y[i]); }
      });
    });
    // A limit that is farther from the curves than these are apart would make them flat.
    var reach = hi - lo, low = lo, high = hi;
    limits.forEach(function (l) {
      l.levels.forEach(function (v) {
        if (v >= low - reach && low + 2 * reach >= v) { lo = Math.min(lo, v); hi = Math.max(hi, v); }
      });
    });
    if (!(hi > lo)) { var mid = isFinite(lo) ? lo : 0; lo = mid - 1; hi = mid + 1; }
    var pad = (hi - lo) * 0.05; lo -= pad; hi += pad;
    function px(x) { return 60 + (x - r[0]) / (r[1] - r[0]) * (w - 70); }
    function py(y) { return h - 24 - (y - lo) / (hi - lo) * (h - 24 - top); }
    g.strokeStyle = grid; g.fillStyle = soft; g.lineWidth = 1; g.textAlign = 'right';
    ticks(lo, hi, 5).forEach(function (v) {
      g.beginPath(); g.moveTo(60, py(v)); g.lineTo(w - 10, py(v)); g.stroke(); g.fillText(fmt(v), 54, py(v) + 4);
    });
    g.textAlign = 'center';
    ticks(r[0], r[1], 8).forEach(function (v) { g.fillText(fmt(v), px(v), h - 6); });
    g.save(); g.beginPath(); g.rect(60, top - 2, w - 70, h - 22 - top); g.clip();
    limits.forEach(function (l) {
      g.fillStyle = g.strokeStyle = shade(l.colour); g.globalAlpha = 0.14; g.beginPath();
      l.failed.forEach(function (f) { g.rect(px(f[0]), top - 2, Math.max(px(f[1]) - px(f[0]), 1), h - 22 - top); });
      g.fill(); g.globalAlpha = 1; g.setLineDash([5, 4]); g.lineWidth = 1.2;
      l.levels.forEach(function (v) {
        g.beginPath(); g.moveTo(px(l.x[0]), py(v)); g.lineTo(px(l.x[1]), py(v)); g.stroke();
      });
      g.setLineDash([]);
    });
    this.d.series.forEach(function (s) {
      g.strokeStyle = shade(s.colour); g.lineWidth = 1.3; g.beginPath();
      var pen = false;
      s.x.forEach(function (x, i) {
        if (s.y[i] === null) { pen = false; return; }
        if (pen) { g.lineTo(px(x), py(s.y[i])); } else { g.moveTo(px(x), py(s.y[i])); pen = true; }
      });
      g.stroke();
    });
    if (this.cursor !== null) {
      g.strokeStyle = ink; g.lineWidth = 0.6; g.beginPath();
      g.moveTo(px(this.cursor), 0); g.lineTo(px(this.cursor), h); g.stroke();
    }
    if (this.drag) {
      g.fillStyle = 'rgba(31,119,201,.15)';
      g.fillRect(px(this.drag[0]), 0, px(this.drag[1]) - px(this.drag[0]), h);
    }
    g.restore();
    g.textAlign = 'left';
    names.forEach(function (n) { g.fillStyle = shade(n[0].colour); g.fillText(n[0].name, n[1], n[2]); });
    asked.forEach(function (n) { g.fillStyle = shade(n[1]); g.fillText(n[0], n[2], n[3]); });
    var read = this.d.series.map(function (s) {
      var best = null, near = Infinity;
      s.x.forEach(function (x, i) {
        if (me.cursor !== null && near > Math.abs(x - me.cursor)) { near = Math.abs(x - me.cursor); best = s.y[i]; }
      });
      return s.name + ' ' + (best === null ? '-' : fmt(best));
    });
    var at = this.cursor === null ? '' : fmt(this.cursor) + ' ' + this.d.unit + ': ';
    this.readout.textContent = at && at + read.join(', ');
  };
  function redraw() { plots.forEach(function (p) { p.draw(); }); }
  document.querySelectorAll('script.plot').forEach(function (block) { plots.push(new Plot(block)); });
  window.addEventListener('resize', redraw);
  window.matchMedia('(prefers-color-scheme: dark)').addEventListener('change', redraw);
  redraw();
})();
"""
