// What the canvas shows of the road: where it looks, how large, and from metres to pixels.

const MIN_SCALE = 0.5;
/** [m] Shown beside the road at least, until someone zooms. */
const BESIDE = 4;
const MAX_SCALE = 60;
/** [1/s] How fast the camera goes to a vehicle that it begins to follow. */
const CATCH_UP = 6;

export class Camera {
  constructor(line, header) {
    this.line = line;
    this.length = header.road_length;
    this.roadWidth = header.num_lanes * header.lane_width;
    this.middle = 0.5 * this.roadWidth;
    this.position = 0;
    this.scale = 8;
    this.fitting = 8;
    this.width = 1;
    this.height = 1;
    this.centre = { x: 0, y: 0, heading: 0 };
    this.work = { x: 0, y: 0, heading: 0 };
    this.point = { x: 0, y: 0, heading: 0 };
    this.isChosen = false;
    this.aim();
  }

  /** Size of the canvas in CSS pixels; until someone zooms, the scale fits it. */
  resize(width, height) {
    this.width = width;
    this.height = height;
    const across = height / (this.roadWidth + 2 * BESIDE);
    this.fitting = Math.min(width / Math.min(140, Math.max(70, width / 9)), across);
    if (!this.isChosen) this.scale = this.fitting;
    this.aim();
  }

  /** Metres of road that it shows. */
  get span() {
    return this.width / this.scale;
  }

  zoom(factor, x = this.width / 2) {
    this.isChosen = true;
    const offset = (x - this.width / 2) / this.scale;
    const before = this.scale;
    const least = Math.min(this.fitting, Math.max(MIN_SCALE, this.width / (1.2 * this.length)));
    this.scale = Math.min(Math.max(this.scale * factor, least), MAX_SCALE);
    this.moveTo(this.position + offset * (1 - before / this.scale));
  }

  moveTo(position) {
    this.position = Math.min(Math.max(position, 0), this.length);
    this.aim();
  }

  /** Glide toward a position, in the time that passed [s]. */
  follow(position, passed) {
    const share = 1 - Math.exp(-CATCH_UP * passed);
    this.moveTo(this.position + share * (position - this.position));
  }

  aim() {
    this.line.place(this.position, this.middle, this.centre);
    this.cosine = Math.cos(this.centre.heading);
    this.sine = Math.sin(this.centre.heading);
  }

  /** Pixel of a place on the road: out.x, out.y, and out.heading relative to the camera. */
  project(position, lateral, out) {
    const { centre, work } = this;
    this.line.place(position, lateral, work);
    const dx = work.x - centre.x;
    const dy = work.y - centre.y;
    out.x = this.width / 2 + this.scale * (dx * this.cosine + dy * this.sine);
    out.y = this.height / 2 - this.scale * (dy * this.cosine - dx * this.sine);
    out.heading = work.heading - centre.heading;
    return out;
  }

  /** Add a place on the road to a path, as its first point or a next one. */
  vertex(context, position, lateral, isFirst) {
    const point = this.project(position, lateral, this.point);
    if (isFirst) context.moveTo(point.x, point.y);
    else context.lineTo(point.x, point.y);
  }

  /** The outline of the road between two lateral positions, as a path. */
  trace(context, first, last, low, high) {
    const places = this.line.breaks(first, last);
    context.beginPath();
    places.forEach((place, i) => this.vertex(context, place, low, i === 0));
    for (let i = places.length - 1; i >= 0; i -= 1) this.vertex(context, places[i], high, false);
    context.closePath();
  }
}
