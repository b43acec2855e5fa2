// Explorers that move without a kernel: draws the pictures that were computed when the site was made, over the
// start in grey. Without this script a page shows the picture at the start.
"use strict";

(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const MARGIN = { left: 52, right: 14, top: 8, bottom: 24 }; // pixels around a plot
  const TALLEST = 400; // pixels, of a plot whose shape is given
  const LETTER = 6.6; // pixels, of a tick's word
  const NARROW = 34 * 16; // below it panels stand under one another

  const make = (name, attributes = {}, ...children) => {
    const element = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.append(...children);
    return element;
  };

  const draw = (parent, name, attributes, ...children) => {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) if (value !== null) element.setAttribute(key, value);
    element.append(...children);
    parent.append(element);
    return element;
  };

  const unpack = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return JSON.parse(await new Response(stream).text());
  };

  // Words with formulas between dollars: letters in italics, indices below, exponents above.
  const words = (text) =>
    text.split("$").flatMap((part, number) => {
      if (number % 2 === 0) return part ? [part] : [];
      const plain = part.replace(/\\hat\s*(\w)/g, "$1\u0302").replace(/\\(?:mathrm|text)\s*/g, "").replace(/\\[,;! ]/g, " ");
      return plain.split(/([_^](?:\{[^}]*\}|.))/).filter(Boolean).map((piece) => {
        if (!/^[_^]./.test(piece)) return make("i", {}, piece.replace(/[{}]/g, ""));
        return make(piece[0] === "_" ? "sub" : "sup", {}, piece.slice(1).replace(/[{}]/g, ""));
      });
    });

  const raised = (number) => String(number).replace(/./g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit] ?? "⁻");

  const number = (value, digits = 3) => {
    if (value === 0) return "0";
    const exponent = Math.floor(Math.log10(Math.abs(value)) + 1e-9);
    if (exponent > -4 && exponent < 5) return String(Number(value.toPrecision(Math.max(digits, exponent + 1)))).replace("-", "−");
    const front = Number((value / 10 ** exponent).toPrecision(digits));
    return `${front === 1 ? "" : `${String(front).replace("-", "−")}·`}10${raised(exponent)}`;
  };

  // Places and words of an axis' ticks; a logarithmic axis counts in decades.
  const ticksOf = ({ log, limits, ticks }, room) => {
    const [low, high] = [Math.min(...limits), Math.max(...limits)];
    const inside = ([at]) => at >= low - 1e-9 * (high - low) && at <= high + 1e-9 * (high - low);
    if (ticks) return ticks.filter(inside);
    const most = Math.max(2, Math.floor(room));
    if (log && high - low >= 1) {
      const step = Math.ceil((high - low) / most);
      const decades = [];
      for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + 1e-9; at += step) decades.push([at, number(10 ** at)]);
      return decades;
    }
    if (log) {
      const front = [1, 2, 5].flatMap((digit) => [Math.floor(low), Math.floor(high)].map((decade) => digit * 10 ** decade));
      return [...new Set(front)].map((value) => [Math.log10(value), number(value)]).filter(inside);
    }
    const rough = (high - low) / most;
    const decade = 10 ** Math.floor(Math.log10(rough));
    const step = decade * [1, 2, 5, 10].find((each) => each * decade >= rough * 0.999);
    const found = [];
    for (let index = Math.ceil(low / step - 1e-9); index * step <= high + 1e-9 * step; index += 1)
      found.push([index * step, number(index * step, Math.max(2, 1 + Math.ceil(Math.log10(high / step) || 0)))]);
    return found;
  };

  const MARKS = {
    o: (r) => `M${-r} 0A${r} ${r} 0 1 0 ${r} 0A${r} ${r} 0 1 0 ${-r} 0Z`,
    D: (r) => `M0 ${-r}L${r} 0L0 ${r}L${-r} 0Z`,
    s: (r) => `M${-r} ${-r}H${r}V${r}H${-r}Z`,
    "^": (r) => `M0 ${-r}L${r} ${r}H${-r}Z`,
    v: (r) => `M0 ${r}L${r} ${-r}H${-r}Z`,
    x: (r) => `M${-r} ${-r}L${r} ${r}M${r} ${-r}L${-r} ${r}`,
    "+": (r) => `M${-r} 0H${r}M0 ${-r}V${r}`,
  };

  // Black lines take the page's ink, white marks its paper: they change with it in the dark.
  const paint = (colour) => ({ "#000000": "currentColor", "#ffffff": "var(--paper)" })[colour] ?? colour ?? "none";

  const pointsOf = (piece) => {
    const points = [];
    let [x, y] = [0, 0];
    for (let at = 0; at < piece.length; at += 2) points.push([(x += piece[at]), (y += piece[at + 1])]);
    return points;
  };

  // One line, area or word; `place` takes units of its own panel to pixels.
  const drawItem = (layer, item, place, ghost) => {
    const drawn = [];
    if (item.text !== undefined) {
      if (ghost) return drawn;
      const [x, y] = place(item.at);
      const text = draw(layer, "text", { x: x + item.shift[0], y: y - item.shift[1], "text-anchor": item.anchor });
      item.text.split("\n").forEach((line, row) => draw(text, "tspan", { x: x + item.shift[0], dy: row ? 13 : 4 }, line.replace(/[${}\\]/g, "")));
      return drawn;
    }
    const pieces = item.path.map((piece) => pointsOf(piece).map(place));
    const outline = pieces.map((points) => `M${points.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}`).join("");
    if (item.fill) draw(layer, "path", { d: `${outline}Z`, fill: ghost ? "none" : paint(item.fill), class: "area" });
    if (item.stroke || (ghost && item.fill))
      draw(layer, "path", {
        d: outline,
        fill: "none",
        stroke: ghost ? null : paint(item.stroke),
        "stroke-width": item.width ?? 1,
        "stroke-dasharray": item.dash ?? null,
      });
    if (item.mark) {
      const [kind, size, edge, face] = item.mark;
      for (const [x, y] of pieces.flat())
        draw(layer, "path", {
          d: MARKS[kind](size / 2),
          transform: `translate(${x.toFixed(1)} ${y.toFixed(1)})`,
          stroke: ghost ? null : paint(edge),
          fill: ghost ? "none" : paint(face),
        });
    }
    if (item.stroke || item.mark) for (const point of pieces.flat()) drawn.push([...point, item.label ?? ""]);
    return drawn;
  };

  const swatch = (item) => {
    const svg = document.createElementNS(SVG, "svg");
    for (const [key, value] of Object.entries({ viewBox: "0 0 28 12", width: 28, height: 12, "aria-hidden": "true" })) svg.setAttribute(key, value);
    const line = { path: [[2, 6, 24, 0]], stroke: item.stroke, width: item.width, dash: item.dash, fill: null };
    if (item.fill) draw(svg, "rect", { x: 2, y: 1, width: 24, height: 10, fill: paint(item.fill) });
    if (item.stroke) drawItem(svg, line, (point) => point, false);
    if (item.mark) drawItem(svg, { path: [[14, 6]], mark: item.mark }, (point) => point, false);
    return svg;
  };

  const unitOf = (label) => /\(([^()]*)\)\s*$/.exec(label.replaceAll("$", ""))?.[1] ?? "";

  // A panel of the picture; under it lies the same panel of the published one, where that is another.
  const panel = (now, published, width) => {
    const longest = Math.max(0, ...(now.y.ticks ?? []).map(([, word]) => word.length));
    const left = Math.max(MARGIN.left, 12 + LETTER * longest);
    const inner = { width: width - left - MARGIN.right, height: Math.max(160, now.height - 90) };
    if (now.ratio) {
      inner.width = Math.min(inner.width, TALLEST / now.ratio);
      inner.height = inner.width * now.ratio;
    }
    const height = inner.height + MARGIN.top + MARGIN.bottom;
    const svg = document.createElementNS(SVG, "svg");
    for (const [key, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, width, height, "aria-hidden": "true" })) svg.setAttribute(key, value);
    const across = (share) => left + share * inner.width;
    const up = (share) => MARGIN.top + (1 - share) * inner.height;
    const shareOf = (axis, at) => (at - axis.limits[0]) / (axis.limits[1] - axis.limits[0]);

    for (const [at, label] of ticksOf(now.x, inner.width / 70)) {
      const x = across(shareOf(now.x, at));
      draw(svg, "line", { class: "grid", x1: x, x2: x, y1: up(0), y2: up(1) });
      draw(svg, "text", { x, y: up(0) + 16, "text-anchor": "middle" }, label.replace(/[${}\\]/g, ""));
    }
    for (const [at, label] of ticksOf(now.y, inner.height / 38)) {
      const y = up(shareOf(now.y, at));
      draw(svg, "line", { class: "grid", x1: across(0), x2: across(1), y1: y, y2: y });
      draw(svg, "text", { x: across(0) - 6, y: y + 4, "text-anchor": "end" }, label.replace(/[${}\\]/g, ""));
    }
    draw(svg, "path", { class: "frame", d: `M${across(0)} ${up(1)}V${up(0)}H${across(1)}` });
    const window_ = { x: across(0), y: up(1), width: inner.width, height: inner.height };
    const plot = draw(svg, "svg", { ...window_, viewBox: Object.values(window_).join(" ") });

    // From one panel's units to a share of this panel's axes, which may have other limits.
    const placeIn = (from) => ([u, v]) => {
      const value = (axis, share) => axis.limits[0] + share * (axis.limits[1] - axis.limits[0]);
      return [
        across(shareOf(now.x, value(from.x, u / from.units[0]))),
        up(shareOf(now.y, value(from.y, v / from.units[1]))),
      ];
    };
    if (published) {
      const ghost = draw(plot, "g", { class: "ghost" });
      for (const item of published.items) drawItem(ghost, item, placeIn(published), true);
    }
    const front = draw(plot, "g", { class: "front" });
    const points = now.items.flatMap((item) => drawItem(front, item, placeIn(now), false));

    const read = make("p", { class: "read" }, "\u00a0");
    const dot = draw(svg, "circle", { class: "dot", r: 4, cx: -10, cy: -10 });
    const back = (axis, share) => {
      const value = axis.limits[0] + share * (axis.limits[1] - axis.limits[0]);
      return axis.log ? 10 ** value : value;
    };
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      const at = [event.clientX - box.left, event.clientY - box.top];
      let [nearest, least] = [null, 60 ** 2];
      for (const point of points) {
        const far = (point[0] - at[0]) ** 2 + (point[1] - at[1]) ** 2;
        if (far < least) [nearest, least] = [point, far];
      }
      dot.setAttribute("cx", nearest ? nearest[0] : -10);
      dot.setAttribute("cy", nearest ? nearest[1] : -10);
      read.textContent = "\u00a0";
      if (!nearest) return;
      const x = number(back(now.x, (nearest[0] - left) / inner.width));
      const y = number(back(now.y, 1 - (nearest[1] - MARGIN.top) / inner.height));
      read.replaceChildren(...words(nearest[2] ? `${nearest[2]}: ` : ""), `${x} ${unitOf(now.x.label)}, ${y} ${unitOf(now.y.label)}`);
    });

    const box = make("div", { class: "panel" });
    const told = now.title.split("\n").flatMap((line, row) => [...(row ? [make("br")] : []), ...words(line)]);
    if (now.title) box.append(make("p", { class: "panel-title" }, ...told));
    box.append(make("p", { class: "axis" }, ...words(now.y.label.replace("\n", " "))), svg);
    box.append(make("p", { class: "axis across" }, ...words(now.x.label.replace("\n", " "))), read);
    if (now.legend !== null) {
      const [heading, ...names] = now.legend;
      const named = now.items.filter((item) => names.includes(item.label));
      const rows = named.map((item) => make("li", {}, swatch(item), " ", ...words(item.label)));
      box.append(make("ul", { class: "key" }, ...(heading ? [make("li", { class: "heading" }, ...words(heading))] : []), ...rows));
    }
    return box;
  };

  const begin = async (figure) => {
    const { controls, joint, states, pictures, presets } = await unpack(figure.dataset.states);
    const home = controls.map((control) => control.start);
    const stops = [...home];
    const area = make("div", { class: "panels", role: "img" });
    const told = make("p", { class: "told", "aria-live": "polite" });
    const unit = (control, at) => `${control.stops[at]}${control.unit ? ` ${control.unit}` : ""}`;

    // The command that builds the page with the settings shown, where it has parameters for them.
    const command = make("code", { class: "command" });
    const quoted = (text) => (/^[\w.,=+-]*$/.test(text) ? text : `'${text}'`);
    const buildLine = () => {
      const moved = controls.filter((control, number) => stops[number] !== home[number]);
      const given = moved.filter((control) => control.parameter).map((control) => ` -p ${quoted(`${control.parameter}=${control.stops[stops[controls.indexOf(control)]]}`)}`);
      const rest = moved.filter((control) => !control.parameter).map((control) => control.name).join(", ");
      return `make figures ARGS="${figure.dataset.notebook}${given.join("")}"${rest ? `  # the page has no parameter ${rest}` : ""}`;
    };

    const show = () => {
      command.textContent = buildLine();
      const begun = performance.now();
      const now = pictures[states[stops.join(".")]];
      const published = pictures[states[home.join(".")]];
      const moved = stops.some((stop, number) => stop !== home[number]);
      for (const { goal, button } of named) button.setAttribute("aria-pressed", goal === stops.join("."));
      const setting = controls.map((control, number) => `${control.name} ${unit(control, stops[number])}`).join(", ");
      area.setAttribute("aria-label", `Picture at ${setting}`);
      told.textContent = now.message ?? (moved ? "Moved; in grey the start." : "At the start.");
      const columns = now.message ? 1 : 1 + Math.max(...now.map((each) => each.place[1]));
      const wide = area.clientWidth >= NARROW ? columns : 1;
      area.dataset.columns = wide;
      const width = Math.floor((area.clientWidth - 16 * (wide - 1)) / wide);
      if (now.message) area.replaceChildren();
      else area.replaceChildren(...now.map((each, number) => panel(each, (moved && !published.message && published[number]) || null, width)));
      figure.dataset.milliseconds = (performance.now() - begun).toFixed(1);
    };

    const rows = controls.map((control, number) => {
      const id = `${figure.id}-${number}`;
      const name = make("label", { for: id }, `${control.name}${control.unit ? ` (${control.unit})` : ""}`);
      const value = make("output", { for: id });
      const options = control.stops.map((stop, at) => make("option", { value: at }, stop));
      const range = { type: "range", min: 0, max: control.stops.length - 1, step: 1 };
      const input = control.choice ? make("select", { id }, ...options) : make("input", { id, ...range });
      const mark = make("span", { class: "home" }, control.basis);
      const set = (stop) => {
        stops[number] = stop;
        input.value = stop;
        if (!control.choice) input.setAttribute("aria-valuetext", unit(control, stop));
        value.textContent = control.choice ? "" : control.stops[stop];
      };
      const move = () => {
        if (Number(input.value) === stops[number]) return;
        for (const [other, row] of rows.entries())
          if (other !== number && !(joint.includes(number) && joint.includes(other))) row.set(home[other]);
        set(Number(input.value));
        show();
      };
      for (const event of ["input", "change"]) input.addEventListener(event, move);
      return { set, element: make("div", { class: "control" }, name, input, value, mark) };
    });

    const leading = (name, goal) => {
      const button = make("button", { type: "button" }, name);
      button.addEventListener("click", () => {
        rows.forEach((row, number) => row.set(goal[number]));
        show();
      });
      return button;
    };
    const reset = leading("Back to the start", home);
    const named = presets.map(([name, goal]) => ({ goal: goal.join("."), button: leading(name, goal) }));
    rows.forEach((row, number) => row.set(home[number]));
    const list = make("div", { class: "controls" }, ...rows.map((row) => row.element), make("div", { class: "control" }, reset, told));
    if (named.length) list.prepend(make("div", { class: "presets", role: "group", "aria-label": "Named designs" }, ...named.map((each) => each.button)));
    if (joint.length < controls.length) {
      const together = joint.map((number) => controls[number].name).join(" and ");
      list.append(make("p", { class: "note" }, `${together} move together; every other control moves alone, from the start.`));
    }
    figure.querySelector(".zoom").replaceWith(list, area);
    if (controls.some((control) => control.parameter)) area.after(command);
    show();
    let width = area.clientWidth;
    new ResizeObserver(() => {
      if (area.clientWidth !== width) {
        width = area.clientWidth;
        show();
      }
    }).observe(area);
    figure.dataset.ready = "yes";
    if ("play" in figure.dataset) play(figure, rows, controls, joint, show);
  };

  // Moves the main control there and back until a reader takes a control or stops it.
  const play = (figure, rows, controls, joint, show) => {
    const pause = figure.querySelector(".pause");
    if (!pause || matchMedia("(prefers-reduced-motion: reduce)").matches) return;
    const main = joint.reduce((a, b) => (controls[b].stops.length > controls[a].stops.length ? b : a));
    let [stop, way] = [controls[main].start, 1];
    const clock = setInterval(() => {
      if (stop + way < 0 || stop + way >= controls[main].stops.length) way = -way;
      rows[main].set((stop += way));
      show();
    }, 600);
    const halt = () => {
      clearInterval(clock);
      pause.hidden = true;
    };
    pause.hidden = false;
    pause.addEventListener("click", halt);
    for (const event of ["pointerdown", "keydown"]) figure.querySelector(".controls").addEventListener(event, halt);
  };

  for (const figure of document.querySelectorAll("figure[data-states]")) begin(figure);
})();
