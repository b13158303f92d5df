// One plot: lines over time, axes, values at the cursor.

import { begin, fit } from "replay/canvas";

const MARGIN = { left: 46, right: 8, top: 8, bottom: 20 };
const DASHES = [[], [6, 3], [2, 2], [8, 3, 2, 3], [4, 4], [1, 3]];

/** Round numbers from low to high, about count of them. */
export function makeTicks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough - 1e-12);
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) ticks.push(i * step);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return { ticks, decimals };
}

export class Plot {
  /** data: of series.makePlots; style(i): the colour of the i-th line. */
  constructor(page, data) {
    this.data = data;
    this.figure = page.createElement("figure");
    this.figure.className = "plot";
    this.figure.dataset.key = data.key;
    const caption = page.createElement("figcaption");
    const title = page.createElement("span");
    title.className = "title";
    title.textContent = `${data.title} [${data.unit.replace("^2", "²")}]`;
    caption.append(title);
    this.values = data.lines.map((line, i) => {
      const item = page.createElement("span");
      item.className = "line";
      const swatch = page.createElement("canvas");
      swatch.className = "swatch";
      swatch.width = 40;
      swatch.height = 8;
      const value = page.createElement("output");
      item.append(swatch, ` ${line.name} `, value);
      caption.append(item);
      return { value, swatch, index: i };
    });
    this.canvas = page.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${data.title} in ${data.unit} over time`);
    this.cursor = page.createElement("div");
    this.cursor.className = "cursor";
    const area = page.createElement("div");
    area.className = "area";
    area.append(this.canvas, this.cursor);
    this.figure.append(caption, area);
  }

  /** The size on the page, read once: while it plays, the cursor moves in every frame. */
  measure() {
    this.inner = {
      left: MARGIN.left,
      width: this.canvas.clientWidth - MARGIN.left - MARGIN.right,
      top: MARGIN.top,
      height: this.canvas.clientHeight - MARGIN.top - MARGIN.bottom,
    };
  }

  /** The time at a pixel of the canvas, within the window. */
  timeAt(x, window) {
    const { left, width } = this.inner;
    const share = Math.min(Math.max((x - left) / width, 0), 1);
    return window.first + share * (window.last - window.first);
  }

  draw(colours, window, phases) {
    fit(this.canvas);
    this.measure();
    const context = begin(this.canvas);
    const { left, width, top, height } = this.inner;
    const range = this.range(window);
    const x = (time) => left + (width * (time - window.first)) / (window.last - window.first);
    const y = (value) => top + height * (1 - (value - range.low) / (range.high - range.low));
    this.drawPhases(context, colours, phases, x);
    this.drawAxes(context, colours, window, range, x, y);
    context.save();
    context.beginPath();
    context.rect(left, top - 2, width, height + 4);
    context.clip();
    this.data.lines.forEach((line, i) => this.drawLine(context, colours, line, i, x, y));
    context.restore();
    for (const { swatch, index } of this.values) this.drawSwatch(swatch, colours, index);
  }

  /** The values in the window, with a margin; with zero where they are near it. */
  range(window) {
    let low = Infinity;
    let high = -Infinity;
    for (const line of this.data.lines) {
      line.values.forEach((value, i) => {
        const time = line.times[i];
        if (!Number.isFinite(value) || time < window.first || time > window.last) return;
        low = Math.min(low, value);
        high = Math.max(high, value);
      });
    }
    if (low > high) return { low: 0, high: 1 };
    const least = Math.max(1e-3, 0.02 * Math.max(Math.abs(low), Math.abs(high)));
    const margin = Math.max(0.06 * (high - low), least);
    return { low: low - margin, high: high + margin };
  }

  drawPhases(context, colours, phases, x) {
    const { left, width, top, height } = this.inner;
    for (const { first, last, name } of phases) {
      const from = Math.max(x(first), left);
      const to = Math.min(x(last), left + width);
      if (to <= from) continue;
      context.globalAlpha = 0.18;
      context.fillStyle = { engaged: colours.safe_gap, aborting: colours.changer }[name] ?? colours.refused_gap;
      context.fillRect(from, top, to - from, height);
    }
    context.globalAlpha = 1;
  }

  drawAxes(context, colours, window, range, x, y) {
    const { left, width, top, height } = this.inner;
    context.font = "11px system-ui, sans-serif";
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    context.fillStyle = colours.muted;
    context.beginPath();
    const vertical = makeTicks(range.low, range.high, Math.max(3, height / 26));
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const tick of vertical.ticks) {
      context.moveTo(left, y(tick));
      context.lineTo(left + width, y(tick));
      context.fillText(tick.toFixed(vertical.decimals), left - 6, y(tick));
    }
    const horizontal = makeTicks(window.first, window.last, Math.max(3, width / 34));
    context.textBaseline = "top";
    context.textAlign = "center";
    horizontal.ticks.forEach((tick, i) => {
      context.moveTo(x(tick), top);
      context.lineTo(x(tick), top + height);
      const unit = i === horizontal.ticks.length - 1 ? " s" : "";
      const text = `${tick.toFixed(horizontal.decimals)}${unit}`;
      const half = context.measureText(text).width / 2;
      context.fillText(text, Math.min(x(tick), this.canvas.clientWidth - half), top + height + 5);
    });
    context.stroke();
    if (range.low < 0 && range.high > 0) {
      context.strokeStyle = colours.muted;
      context.beginPath();
      context.moveTo(left, y(0));
      context.lineTo(left + width, y(0));
      context.stroke();
    }
  }

  drawLine(context, colours, line, index, x, y) {
    context.strokeStyle = colours.series[index % colours.series.length];
    context.lineWidth = 1.8;
    context.setLineDash(DASHES[index % DASHES.length]);
    context.beginPath();
    let isOn = false;
    line.values.forEach((value, i) => {
      const isKnown = Number.isFinite(value);
      if (isKnown && isOn) context.lineTo(x(line.times[i]), y(value));
      else if (isKnown) context.moveTo(x(line.times[i]), y(value));
      isOn = isKnown;
    });
    context.stroke();
    context.setLineDash([]);
  }

  drawSwatch(swatch, colours, index) {
    const context = swatch.getContext("2d");
    context.clearRect(0, 0, 40, 8);
    context.strokeStyle = colours.series[index % colours.series.length];
    context.lineWidth = 4;
    context.setLineDash(DASHES[index % DASHES.length].map((one) => 2 * one));
    context.beginPath();
    context.moveTo(0, 4);
    context.lineTo(40, 4);
    context.stroke();
  }

  /** Move the cursor, and write the values at it. */
  point(time, window, step) {
    const { left, width } = this.inner;
    const share = (time - window.first) / (window.last - window.first);
    const isIn = share >= 0 && share <= 1;
    this.cursor.hidden = !isIn;
    this.cursor.style.transform = `translateX(${left + share * width}px)`;
    this.data.lines.forEach((line, i) => {
      const value = isIn ? line.at(time, step) : NaN;
      const text = Number.isFinite(value) ? format(value) : "–";
      if (text === this.values[i].text) return;
      this.values[i].text = text;
      this.values[i].value.textContent = text;
    });
  }
}

/** Three or so digits. */
function format(value) {
  const size = Math.abs(value);
  const text = value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3);
  return text.replace("-", "−");
}
