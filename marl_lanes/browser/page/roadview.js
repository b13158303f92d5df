// The road around the camera: ground, lanes, markings, posts.

const DASH = 6;
const GAP = 12;
/** [m] Between the posts that show the position. */
const POST = 50;
const SHOULDER = 1.2;
/** [m] How far the stripes on the ground reach; no curve is narrower. */
const BESIDE = 45;

export class RoadView {
  constructor(camera, header) {
    this.camera = camera;
    this.header = header;
    this.point = { x: 0, y: 0, heading: 0 };
  }

  draw(context, colours) {
    const { camera, header } = this;
    const width = header.num_lanes * header.lane_width;
    // Seen from a bend, more of the road can be in view than the canvas is wide.
    const reach = 0.6 * Math.max(camera.span, camera.height / camera.scale) + 5;
    const first = camera.position - reach;
    const last = camera.position + reach;
    context.fillStyle = colours.ground;
    context.fillRect(0, 0, camera.width, camera.height);
    this.stripes(context, first, last, width, colours);
    this.band(context, first, last, -SHOULDER, width + SHOULDER, colours.road);
    for (let lane = 0; lane <= header.num_lanes; lane += 1) {
      const isEdge = lane === 0 || lane === header.num_lanes;
      this.marking(context, lane * header.lane_width, first, last, isEdge, colours);
    }
    for (const end of [0, header.road_length]) {
      if (end > first && end < last) this.line(context, end, 0, width, colours.marking, 2);
    }
    this.posts(context, Math.max(0, first), Math.min(header.road_length, last), colours);
  }

  /** Stripes on the ground, which stand still, so that motion is seen. */
  stripes(context, first, last, width, colours) {
    context.globalAlpha = 0.05;
    for (let at = Math.floor(first / POST) * POST; at < last; at += POST) {
      this.band(context, at, at + POST / 2, -BESIDE, width + BESIDE, colours.text);
    }
    context.globalAlpha = 1;
  }

  band(context, first, last, low, high, colour) {
    this.camera.trace(context, first, last, low, high);
    context.fillStyle = colour;
    context.fill();
  }

  marking(context, lateral, first, last, isEdge, colours) {
    context.strokeStyle = colours.marking;
    context.lineWidth = Math.max(1, 0.15 * this.camera.scale);
    context.beginPath();
    if (isEdge) {
      this.along(context, lateral, first, last);
    } else {
      context.globalAlpha = 0.75;
      for (let at = Math.floor(first / (DASH + GAP)) * (DASH + GAP); at < last; at += DASH + GAP) {
        this.along(context, lateral, at, at + DASH);
      }
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  along(context, lateral, first, last) {
    this.camera.line.breaks(first, last).forEach((place, i) => {
      this.camera.vertex(context, place, lateral, i === 0);
    });
  }

  line(context, position, low, high, colour, width) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    this.camera.vertex(context, position, low, true);
    this.camera.vertex(context, position, high, false);
    context.stroke();
  }

  posts(context, first, last, colours) {
    const { camera } = this;
    const every = POST * 2 ** Math.max(0, Math.ceil(Math.log2(90 / (POST * camera.scale))));
    context.fillStyle = colours.muted;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "top";
    for (let at = Math.ceil(first / every) * every; at <= last; at += every) {
      this.line(context, at, -SHOULDER, -SHOULDER - 8 / camera.scale, colours.muted, 1);
      const point = camera.project(at, -SHOULDER - 12 / camera.scale, this.point);
      context.fillText(`${at} m`, point.x, point.y);
    }
  }
}
