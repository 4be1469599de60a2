"use strict";
// Charts of the flight page: every chart over time shares one range; a drag, the wheel or two fingers change it.
let W = 640;
const NS = "http://www.w3.org/2000/svg", H = 208, L = 52, R = 8, T = 6, B = 20, DASH = ["", "7 3", "2 3", "9 3 2 3"];
const charts = [], full = {}, range = {};
const el = (name, at, inside) => {
  const e = document.createElementNS(NS, name);
  for (const k in at) e.setAttribute(k, at[k]);
  if (inside !== undefined) e.textContent = inside;
  return e;
};
function ticks(a, b, n) {
  const raw = (b - a) / n, p = 10 ** Math.floor(Math.log10(raw)), s = [1, 2, 5, 10].find(k => k * p >= raw) * p, out = [];
  for (let t = Math.ceil(a / s) * s; t <= b + 1e-9 * s; t += s) out.push(+t.toPrecision(10));
  return out;
}
function extent(lines, a, b) {
  let low = Infinity, high = -Infinity;
  for (const l of lines) for (let i = 0; i < l.x.length; i++) {
    const y = l.y[i];
    if (y !== null && l.x[i] >= a && l.x[i] <= b) { if (y < low) low = y; if (y > high) high = y; }
  }
  if (low > high) return [0, 1];
  const room = (high - low || Math.abs(high) || 1) * 0.06;
  return [low - room, high + room];
}
function draw(c) {
  const [a, b] = range[c.over], shown = row => row.cells.flatMap((k, i) => k.lines.filter((l, n) => !charts[row.first + i].off.has(n)));
  const [low, high] = c.row.span || extent(shown(c.row), a, b);   // one scale for both logs
  W = c.svg.clientWidth || 640;
  c.svg.setAttribute("viewBox", `0 0 ${W} ${H}`);
  const X = x => L + (x - a) / (b - a) * (W - L - R), Y = y => H - B - (y - low) / (high - low) * (H - T - B);
  c.svg.replaceChildren();
  for (const y of ticks(low, high, 4)) {
    c.svg.append(el("line", { x1: L, x2: W - R, y1: Y(y), y2: Y(y), stroke: "var(--line)" }), el("text", { x: L - 5, y: Y(y) + 4, "text-anchor": "end" }, y));
  }
  for (const x of ticks(a, b, Math.max(3, W / 90))) c.svg.append(el("text", { x: X(x), y: H - 5, "text-anchor": "middle" }, x));
  c.svg.append(el("text", { x: W - R, y: H - B - 4, "text-anchor": "end" }, c.over));
  if (c.over !== "Hz") for (const e of DATA.events[c.log]) if (e.t >= a && e.t <= b) {
    const mark = el("line", { x1: X(e.t), x2: X(e.t), y1: T, y2: H - B, stroke: "var(--dim)", "stroke-dasharray": "1 3" });
    mark.append(el("title", {}, e.t + " s: " + e.text));
    c.svg.append(mark);
  }
  c.lines.forEach((l, n) => {
    if (c.off.has(n)) return;
    let d = "", up = true;
    for (let i = 0; i < l.x.length; i++) {
      if (l.y[i] === null || l.x[i + 1] < a || l.x[i - 1] > b) { up = true; continue; }
      d += (up ? "M" : "L") + X(l.x[i]).toFixed(1) + " " + Y(l.y[i]).toFixed(1);
      up = false;
    }
    const style = { d, fill: "none", stroke: COLOURS[l.look % COLOURS.length], "stroke-width": 1.4, "clip-path": "url(#inside)" };
    if (l.dashed || l.look > 3) style["stroke-dasharray"] = l.dashed ? "5 3" : DASH[1 + (l.look % 3)];
    c.svg.append(el("path", style));
  });
  const defs = el("defs", {}), clip = el("clipPath", { id: "inside" });
  clip.append(el("rect", { x: L, y: T, width: W - L - R, height: H - T - B }));
  defs.append(clip); c.svg.append(defs);
}
function set(over, a, b) {
  const [low, high] = full[over], least = (high - low) / 5000;
  if (b - a < least) return;
  range[over] = [Math.max(a, low), Math.min(b, high)];
  charts.filter(c => c.over === over).forEach(draw);
}
function hear(c) {
  const at = e => { W = c.svg.clientWidth; const box = c.svg.getBoundingClientRect(), [a, b] = range[c.over]; return a + ((e.clientX - box.left) / box.width * W - L) / (W - L - R) * (b - a); };
  const down = new Map(); let from = null, box = null;
  c.svg.addEventListener("pointerdown", e => { down.set(e.pointerId, at(e)); from = down.size === 1 ? at(e) : null; c.svg.setPointerCapture(e.pointerId); });
  c.svg.addEventListener("pointermove", e => {
    document.getElementById("at").textContent = at(e).toFixed(2) + (c.over === "Hz" ? " Hz" : " s");
    if (down.size === 2) {   // two fingers: what was under each stays under it
      const [one, two] = [...down.entries()].sort((p, q) => p[1] - q[1]), x = (e.clientX - c.svg.getBoundingClientRect().left) / c.svg.clientWidth * W;
      const fixed = one[0] === e.pointerId ? two[1] : one[1], moved = one[0] === e.pointerId ? one[1] : two[1], [a, b] = range[c.over];
      const fx = L + (fixed - a) / (b - a) * (W - L - R), s = (x - fx) / (moved - fixed);
      if (s > 0) set(c.over, fixed - (fx - L) / s, fixed + (W - R - fx) / s);
      return;
    }
    if (from === null) return;
    if (box) box.remove();
    const [a, b] = range[c.over], X = x => L + (x - a) / (b - a) * (W - L - R), to = at(e);
    box = el("rect", { x: X(Math.min(from, to)), y: T, width: Math.abs(X(to) - X(from)), height: H - T - B, fill: "var(--mark)", opacity: .18 });
    c.svg.append(box);
  });
  const up = e => {
    down.delete(e.pointerId);
    if (box) { box.remove(); box = null; const to = at(e); set(c.over, Math.min(from, to), Math.max(from, to)); }
    from = null;
  };
  c.svg.addEventListener("pointerup", up); c.svg.addEventListener("pointercancel", up);
  c.svg.addEventListener("dblclick", () => set(c.over, ...full[c.over]));
  c.svg.addEventListener("wheel", e => { if (!e.ctrlKey && !e.shiftKey) return; e.preventDefault(); const x = at(e), [a, b] = range[c.over], s = e.deltaY > 0 ? 1.25 : 0.8; set(c.over, x - (x - a) * s, x + (b - x) * s); }, { passive: false });
}
for (const row of DATA.rows) {
  row.first = charts.length;
  row.cells.forEach((cell, log) => {
    const c = { row, log, over: row.over, lines: cell.lines, note: cell.note, off: new Set(), svg: el("svg", { role: "img" }) };
    const box = document.createElement("div"), head = document.createElement("h3"), legend = document.createElement("div");
    box.className = "chart"; legend.className = "legend";
    head.textContent = row.title + ", " + row.unit + (DATA.logs.length > 1 ? " (" + DATA.logs[log] + ")" : "");
    c.svg.setAttribute("aria-label", head.textContent);
    cell.lines.forEach((l, n) => {
      const key = document.createElement("button"), mark = document.createElement("i");
      mark.style.borderColor = COLOURS[l.look % COLOURS.length]; mark.style.borderTopStyle = l.dashed || l.look > 3 ? "dashed" : "solid";
      key.append(mark, l.name);
      key.onclick = () => { c.off.has(n) ? c.off.delete(n) : c.off.add(n); key.className = c.off.has(n) ? "off" : ""; charts.filter(o => o.row === row).forEach(draw); };
      legend.append(key);
      for (const x of [l.x[0], l.x[l.x.length - 1]]) if (x !== undefined) { const f = full[row.over] ||= [x, x]; f[0] = Math.min(f[0], x); f[1] = Math.max(f[1], x); }
    });
    if (cell.note || !cell.lines.length) { const note = document.createElement("span"); note.textContent = cell.note || "nothing to draw"; legend.append(note); }
    if (cell.lines.length) box.append(head, c.svg, legend); else box.append(head, legend);   // no frame around nothing
    document.getElementById("charts").append(box);
    charts.push(c);
  });
}
for (const over of new Set(charts.map(c => c.over))) range[over] = full[over] ||= [0, 1];
charts.forEach(c => { draw(c); hear(c); });
addEventListener("resize", () => charts.forEach(draw));
document.getElementById("all").onclick = () => Object.keys(full).forEach(over => set(over, ...full[over]));
