// Plots on a canvas of our own, and the same as SVG.

const PAD = { left: 58, right: 14, top: 10, bottom: 38 };

export function palette(element) {
  const style = getComputedStyle(element), of = (name) => style.getPropertyValue(`--${name}`).trim();
  return Object.fromEntries(
    ["ink", "soft", "line", "grid", "paper", "blue", "vermillion", "green", "orange", "purple", "sky", "ghost", "band"].map((name) => [name, of(name)]),
  );
}

const superscript = (n) => String(n).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
export function shortNumber(x) {
  if (x === 0) return "0";
  const size = Math.abs(x);
  if (size >= 1e5 || size < 1e-3) {
    const decade = Math.floor(Math.log10(size) + 1e-9), digit = x / 10 ** decade;
    const lead = Math.abs(digit - 1) < 1e-6 ? "" : `${Number(digit.toPrecision(3))}·`;
    return `${lead}10${superscript(decade)}`;
  }
  return String(Number(x.toPrecision(4))).replace("-", "−");
}

function linearTicks(low, high, most) {
  const raw = (high - low) / most, decade = 10 ** Math.floor(Math.log10(raw));
  const step = decade * [1, 2, 5, 10].find((each) => each * decade >= raw);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push({ value: k * step, text: shortNumber(Number((k * step).toPrecision(12))), major: true });
  return ticks;
}
function degreeTicks(low, high) {
  const ticks = [];
  for (let value = Math.ceil(low / 90) * 90; value <= high; value += 90) ticks.push({ value, text: shortNumber(value), major: true });
  return ticks;
}
function logTicks(low, high) {
  const ticks = [], first = Math.floor(Math.log10(low)), last = Math.ceil(Math.log10(high)), few = Math.log10(high / low) < 1.5;
  for (let decade = first; decade <= last; decade++) {
    for (let digit = 1; digit < 10; digit++) {
      const value = digit * 10 ** decade;
      if (value < low * 0.9999 || value > high * 1.0001) continue;
      ticks.push({ value, text: digit === 1 || (few && (digit === 2 || digit === 5)) ? shortNumber(value) : "", major: digit === 1 });
    }
  }
  return ticks;
}

// A plot: `frame` sets the axes, `paint` draws. `x` and `y` are {low, high, log, label, degrees}.
export function makePlot(canvas, { title, equal = false }) {
  const plot = { canvas, title, width: 0, height: 0, x: null, y: null, content: null, hover: null };
  plot.resize = () => {
    const box = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2);
    plot.width = Math.max(box.width, 120);
    plot.height = Math.max(box.height, 90);
    canvas.width = Math.round(plot.width * ratio);
    canvas.height = Math.round(plot.height * ratio);
    plot.ratio = ratio;
  };
  plot.frame = (x, y) => {
    if (equal) {
      // One unit is as long in both directions.
      const wide = plot.width - PAD.left - PAD.right, high = plot.height - PAD.top - PAD.bottom;
      const scale = Math.max((x.high - x.low) / wide, (y.high - y.low) / high);
      const widen = (axis, pixels) => {
        const middle = (axis.low + axis.high) / 2;
        return { ...axis, low: middle - (scale * pixels) / 2, high: middle + (scale * pixels) / 2 };
      };
      [x, y] = [widen(x, wide), widen(y, high)];
    }
    plot.x = x;
    plot.y = y;
  };
  const place = (axis, from, to) => {
    const map = axis.log ? Math.log : (value) => value, low = map(axis.low), scale = (to - from) / (map(axis.high) - low);
    return (value) => from + scale * (map(value) - low);
  };
  plot.toX = (value) => place(plot.x, PAD.left, plot.width - PAD.right)(value);
  plot.toY = (value) => place(plot.y, plot.height - PAD.bottom, PAD.top)(value);
  plot.fromX = (pixel) => {
    const share = (pixel - PAD.left) / (plot.width - PAD.left - PAD.right);
    return plot.x.log ? plot.x.low * (plot.x.high / plot.x.low) ** share : plot.x.low + share * (plot.x.high - plot.x.low);
  };
  plot.perPixelY = () => (plot.y.high - plot.y.low) / (plot.height - PAD.top - PAD.bottom);
  plot.inside = (x, y) => x >= PAD.left && x <= plot.width - PAD.right && y >= PAD.top && y <= plot.height - PAD.bottom;
  plot.paint = (content, colours) => {
    plot.content = content;
    plot.colours = colours;
    const context = canvas.getContext("2d");
    context.setTransform(plot.ratio, 0, 0, plot.ratio, 0, 0);
    context.clearRect(0, 0, plot.width, plot.height);
    drawAxes(context, plot, colours);
    drawCurves(context, plot, plot.content, colours);
  };
  plot.repaint = () => plot.content && plot.paint(plot.content, plot.colours);
  return plot;
}

const FONT = '12px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
const edges = ({ width, height }) => ({ left: PAD.left, right: width - PAD.right, top: PAD.top, bottom: height - PAD.bottom });

function drawAxes(context, plot, colours) {
  const { height, x, y, toX, toY } = plot, { left, right, top, bottom } = edges(plot);
  context.font = FONT;
  const tall = Math.max(3, Math.round((bottom - top) / 45)), wide = Math.max(3, Math.round((right - left) / 90));
  const xTicks = x.log ? logTicks(x.low, x.high) : linearTicks(x.low, x.high, wide);
  const yTicks = y.log ? logTicks(y.low, y.high) : y.degrees ? degreeTicks(y.low, y.high) : linearTicks(y.low, y.high, tall);
  context.lineWidth = 1;
  // All lines of a colour in one path, on whole pixels: these are drawn at every frame.
  const whole = (value) => Math.round(value) + 0.5;
  for (const [colour, major] of [[colours.grid, false], [colours.line, true]]) {
    context.strokeStyle = colour;
    context.beginPath();
    for (const { value } of xTicks.filter((tick) => Boolean(tick.major) === major)) {
      context.moveTo(whole(toX(value)), top);
      context.lineTo(whole(toX(value)), bottom);
    }
    for (const { value } of yTicks.filter((tick) => Boolean(tick.major) === major)) {
      context.moveTo(left, whole(toY(value)));
      context.lineTo(right, whole(toY(value)));
    }
    context.stroke();
  }
  context.fillStyle = colours.soft;
  context.textBaseline = "top";
  context.textAlign = "center";
  let free = -Infinity;
  for (const tick of xTicks) {
    const at = toX(tick.value);
    if (!tick.text || at < free) continue;
    context.fillText(tick.text, at, bottom + 5);
    free = at + 10 + 7 * tick.text.length;
  }
  context.fillText(x.label, (left + right) / 2, height - 15);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const tick of yTicks) if (tick.text) context.fillText(tick.text, left - 6, toY(tick.value));
  context.save();
  context.translate(11, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillText(y.label, 0, 0);
  context.restore();
}

function drawCurves(context, plot, { series = [], bands = [], rules = [], circles = [], texts = [] }, colours) {
  const { x, y, toX, toY } = plot, { left, right, top, bottom } = edges(plot);
  context.font = FONT;
  context.lineJoin = "bevel";
  context.save();
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.clip();
  // The mappings written out: these are drawn at every frame.
  const startX = x.log ? Math.log(x.low) : x.low, perX = (right - left) / ((x.log ? Math.log(x.high) : x.high) - startX);
  const perY = (bottom - top) / (y.high - y.low);
  const quickX = (value) => left + perX * ((x.log ? Math.log(value) : value) - startX);
  const quickY = (value) => (y.log ? toY(value) : bottom - perY * (value - y.low));
  for (const { x: xs, low, high, colour } of bands) {
    context.fillStyle = colour;
    context.beginPath();
    // Of the points that share a pixel the outermost.
    const edge = [];
    for (let k = 0; k < xs.length; k++) {
      const px = quickX(xs[k]), up = clampY(quickY(high[k]), plot), down = clampY(quickY(low[k]), plot), last = edge[edge.length - 1];
      if (last && px - last.px < 0.5) {
        last.up = Math.min(last.up, up);
        last.down = Math.max(last.down, down);
      } else edge.push({ px, up, down });
    }
    for (const { px, up } of edge) context.lineTo(px, up);
    for (const { px, down } of edge.reverse()) context.lineTo(px, down);
    context.closePath();
    context.fill();
  }
  for (const { x: at, y: value, colour, dash = [] } of rules) {
    context.strokeStyle = colour;
    context.lineWidth = 1.2;
    context.setLineDash(dash);
    if (value !== undefined) stroke(context, [left, right], [toY(value), toY(value)]);
    else stroke(context, [toX(at), toX(at)], [top, bottom]);
  }
  for (const { x: cx, y: cy, radius, colour, dash = [] } of circles) {
    context.strokeStyle = colour;
    context.lineWidth = 1.2;
    context.setLineDash(dash);
    context.beginPath();
    context.arc(toX(cx), toY(cy), Math.abs(toX(cx + radius) - toX(cx)), 0, 2 * Math.PI);
    context.stroke();
  }
  for (const { x: xs, y: ys, colour, width: thick = 1.6, dash = [], wrap = Infinity } of series) {
    context.strokeStyle = colour;
    context.lineWidth = thick;
    context.setLineDash(dash);
    context.beginPath();
    for (let k = 0, pen = false, lastX = 0, lastY = 0; k < xs.length; k++) {
      const px = quickX(xs[k]), py = quickY(ys[k]);
      if (!(py > -1e5 && py < 1e5 && px > -1e5 && px < 1e5)) {
        pen = false;
        continue;
      }
      // Points that no eye tells apart cost as much as others.
      if (pen && Math.abs(px - lastX) + Math.abs(py - lastY) < 1 && k < xs.length - 1) continue;
      lastX = px;
      lastY = py;
      if (pen && Math.abs(ys[k] - ys[k - 1]) < wrap) context.lineTo(px, py);
      else context.moveTo(px, py);
      pen = true;
    }
    context.stroke();
  }
  context.setLineDash([]);
  context.textBaseline = "middle";
  context.textAlign = "left";
  for (const { x: at, y: value, text, colour } of texts) {
    context.fillStyle = colour;
    context.fillText(text, toX(at) + 6, toY(value) - 8);
  }
  context.restore();
  context.strokeStyle = colours.soft;
  context.lineWidth = 1;
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.stroke();
  drawLegend(context, series.filter((each) => each.name), right, top, colours);
  if (plot.hover && plot.inside(plot.hover.x, plot.hover.y)) drawHover(context, plot, series, colours);
}

function stroke(context, xs, ys) {
  context.beginPath();
  context.moveTo(xs[0], ys[0]);
  context.lineTo(xs[1], ys[1]);
  context.stroke();
}
const clampY = (value, plot) => Math.min(Math.max(value, -100), plot.height + 100);

function drawLegend(context, named, right, top, colours) {
  context.textAlign = "right";
  context.textBaseline = "middle";
  if (named.length) {
    const wide = Math.max(...named.map(({ name }) => context.measureText(name).width)) + 42;
    context.fillStyle = colours.paper;
    context.fillRect(right - wide - 2, top + 2, wide, 16 * named.length + 4);
  }
  named.forEach(({ name, colour, dash = [] }, k) => {
    const y = top + 12 + 16 * k;
    context.fillStyle = colours.ink;
    context.fillText(name, right - 34, y);
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.setLineDash(dash);
    stroke(context, [right - 28, right - 8], [y, y]);
  });
  context.setLineDash([]);
}

// What stands under the pointer: the first curve's nearest point.
function drawHover(context, plot, series, colours) {
  const main = series.find((each) => each.name) ?? series[0];
  if (!main) return;
  let best = -1, least = Infinity;
  for (let k = 0; k < main.x.length; k++) {
    const dx = plot.toX(main.x[k]) - plot.hover.x, far = plot.canvas.dataset.both ? dx * dx + (plot.toY(main.y[k]) - plot.hover.y) ** 2 : dx * dx;
    if (far < least) [least, best] = [far, k];
  }
  if (best < 0) return;
  const px = plot.toX(main.x[best]), py = Math.min(Math.max(plot.toY(main.y[best]), PAD.top), plot.height - PAD.bottom);
  context.fillStyle = main.colour;
  context.beginPath();
  context.arc(px, py, 3.5, 0, 2 * Math.PI);
  context.fill();
  const unit = (label) => (label.match(/\(([^)]*)\)$/) ?? ["", ""])[1];
  const text = `${shortNumber(Number(main.x[best].toPrecision(4)))} ${unit(plot.x.label)}: ${shortNumber(Number(main.y[best].toPrecision(4)))} ${unit(plot.y.label)}`;
  context.textAlign = "left";
  context.textBaseline = "middle";
  const wide = context.measureText(text).width + 12;
  context.fillStyle = colours.paper;
  context.fillRect(PAD.left + 4, plot.height - PAD.bottom - 24, wide, 20);
  context.fillStyle = colours.ink;
  context.fillText(text, PAD.left + 10, plot.height - PAD.bottom - 14);
}

// The same calls as those of a canvas, written down as SVG.
export function svgOf(plot) {
  const parts = [], stack = [];
  let path = "", transform = "", clip = "", clips = 0, dash = [];
  const clean = (text) => String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
  const two = (x) => Number(x.toFixed(2));
  const wrap = () => (transform ? ` transform="${transform}"` : "") + (clip ? ` clip-path="url(#${clip})"` : "");
  const context = {
    beginPath: () => (path = ""),
    moveTo: (x, y) => (path += `M${two(x)} ${two(y)}`),
    lineTo: (x, y) => (path += `${path ? "L" : "M"}${two(x)} ${two(y)}`),
    closePath: () => (path += "Z"),
    rect: (x, y, w, h) => (path += `M${two(x)} ${two(y)}h${two(w)}v${two(h)}h${two(-w)}Z`),
    arc: (x, y, r) => (path += `M${two(x - r)} ${two(y)}a${two(r)} ${two(r)} 0 1 0 ${two(2 * r)} 0a${two(r)} ${two(r)} 0 1 0 ${two(-2 * r)} 0`),
    clip: () => {
      clip = `clip${++clips}`;
      parts.push(`<clipPath id="${clip}"><path d="${path}"/></clipPath>`);
    },
    stroke: () => parts.push(`<path d="${path}" fill="none" stroke="${context.strokeStyle}" stroke-width="${context.lineWidth}"${dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : ""} stroke-linejoin="round"${wrap()}/>`),
    fill: () => parts.push(`<path d="${path}" fill="${context.fillStyle}"${wrap()}/>`),
    fillRect: (x, y, w, h) => parts.push(`<rect x="${two(x)}" y="${two(y)}" width="${two(w)}" height="${two(h)}" fill="${context.fillStyle}"/>`),
    fillText: (text, x, y) => {
      const anchor = { left: "start", center: "middle", right: "end" }[context.textAlign];
      const shift = context.textBaseline === "top" ? 11 : 4;
      parts.push(`<text x="${two(x)}" y="${two(y + shift)}" text-anchor="${anchor}" fill="${context.fillStyle}"${wrap()}>${clean(text)}</text>`);
    },
    measureText: (text) => ({ width: 7 * text.length }),
    setLineDash: (values) => (dash = values),
    save: () => stack.push([transform, clip]),
    restore: () => ([transform, clip] = stack.pop()),
    translate: (x, y) => (transform += `translate(${two(x)} ${two(y)})`),
    rotate: (angle) => (transform += `rotate(${two((angle * 180) / Math.PI)})`),
  };
  const hover = plot.hover;
  plot.hover = null;
  drawAxes(context, plot, plot.colours);
  drawCurves(context, plot, plot.content, plot.colours);
  plot.hover = hover;
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${plot.width}" height="${plot.height}" viewBox="0 0 ${plot.width} ${plot.height}" font-family="system-ui, sans-serif" font-size="12"><title>${clean(plot.title)}</title><rect width="100%" height="100%" fill="${plot.colours.paper}"/>${parts.join("")}</svg>\n`;
}
