// Vehicles on the road: bodies, indicators, brake lights, the gap of a changer, the selected one.

const GLASS = "#262e3a";
const HEADLIGHT = "#fffae1";
const OUTLINED = ["cooperative", "neutral", "adversarial"];
/** [s] Half a period of an indicator. */
const BLINK = 0.4;
/** Bodies are drawn at least this long, so that they are seen from afar [px]. */
const MIN_LENGTH = 6;
/** Length by width from which a body is drawn as a tractor with a trailer. */
const MIN_TRUCK = 4;

function traceBody(context, length, width) {
  context.beginPath();
  context.roundRect(-length / 2, -width / 2, length, width, 0.2 * width);
}

export class Cars {
  constructor(camera, header, store) {
    this.camera = camera;
    this.header = header;
    this.point = { x: 0, y: 0, heading: 0 };
    this.names = {
      disposition: store.names("disposition"),
      phase: store.names("phase"),
      outcome: store.names("outcome"),
      fate: store.names("fate"),
    };
    this.enlarged = 1;
  }

  draw(context, colours, scene, selected) {
    const { camera } = this;
    const shortest = Math.min(...this.header.bodies.map((body) => body.length));
    this.enlarged = Math.max(1, MIN_LENGTH / (shortest * camera.scale));
    const chosen = scene.find(selected);
    if (chosen >= 0) this.drawGap(context, colours, scene, chosen);
    const reach = 0.6 * Math.max(camera.span, camera.height / camera.scale) + 10;
    for (let i = 0; i < scene.count; i += 1) {
      if (Math.abs(scene.position[i] - camera.position) < reach) {
        this.drawCar(context, colours, scene, i);
      }
    }
    if (chosen >= 0) this.drawRing(context, colours, scene, chosen);
  }

  /** Length and width of the i-th vehicle [m]. */
  body(scene, i) {
    return this.header.bodies[scene.value("profile", i)];
  }

  /** Run paint(length, width) in the frame of a body: x ahead, y to the right, in pixels. */
  within(context, body, position, lateral, yaw, paint) {
    const { camera, enlarged } = this;
    const point = camera.project(position, lateral, this.point);
    context.save();
    context.translate(point.x, point.y);
    context.rotate(-(point.heading + yaw));
    const scale = camera.scale * enlarged;
    paint(body.length * scale, body.width * scale);
    context.restore();
  }

  withinCar(context, scene, i, paint) {
    const { position, lateral, yaw } = scene;
    this.within(context, this.body(scene, i), position[i], lateral[i], yaw[i], paint);
  }

  drawCar(context, colours, scene, i) {
    const isChanger = scene.value("command", i) >= 0;
    const disposition = this.names.disposition[scene.value("disposition", i)];
    const isBraking = scene.value("acceleration", i) < this.header.brake_light;
    const fate = this.names.fate[scene.value("fate", i)];
    const isHit = fate === "collides" || fate === "strays";
    const turn = this.turning(scene, i);
    this.withinCar(context, scene, i, (length, width) => {
      context.fillStyle = isChanger ? colours.changer : colours.vehicle;
      traceBody(context, length, width);
      context.fill();
      if (length > MIN_TRUCK * width) this.drawCab(context, length, width);
      else if (length > 16) this.drawWindows(context, length, width);
      this.drawOutline(context, colours, disposition, length, width);
      if (isBraking) this.drawBrakes(context, colours, length, width);
      if (turn !== 0 && Math.floor(scene.time / BLINK + 1e-6) % 2 === 0) {
        this.drawIndicator(context, colours, length, width, turn);
      }
      if (isHit) this.drawCross(context, colours, length);
    });
  }

  /** 1 while a vehicle indicates left, -1 right, else 0. */
  turning(scene, i) {
    const command = scene.value("command", i);
    if (command < 0) return scene.value("moving_over", i);
    if (this.names.outcome[scene.value("outcome", i)] !== "unfinished") return 0;
    const direction = scene.value("direction", i);
    return this.names.phase[scene.value("phase", i)] === "aborting" ? -direction : direction;
  }

  /** The joint between tractor and trailer, and a windscreen; no window behind. */
  drawCab(context, length, width) {
    context.fillStyle = GLASS;
    for (const [front, size] of [[1, 0.22], [0.22, 0.18]]) {
      context.fillRect(length / 2 - (front + size) * width, -width / 2, size * width, width);
    }
  }

  drawWindows(context, length, width) {
    context.fillStyle = GLASS;
    context.beginPath();
    context.moveTo(0.1 * length, -0.4 * width);
    context.lineTo(0.25 * length, -0.32 * width);
    context.lineTo(0.25 * length, 0.32 * width);
    context.lineTo(0.1 * length, 0.4 * width);
    context.closePath();
    context.fill();
    context.fillRect(-0.38 * length, -0.34 * width, 0.1 * length, 0.68 * width);
    context.fillStyle = HEADLIGHT;
    const size = 0.14 * width;
    for (const side of [-1, 1]) {
      context.fillRect(0.48 * length - size, side * 0.33 * width - size / 2, size, size);
    }
  }

  /** By disposition; told apart by their patterns, too. */
  drawOutline(context, colours, disposition, length, width) {
    const name = OUTLINED.includes(disposition) ? disposition : "external";
    const thin = Math.max(1, 0.07 * width);
    const thick = Math.max(1.5, 0.15 * width);
    const stroke = (colour, thickness, dashes = []) => {
      context.strokeStyle = colour;
      context.lineWidth = thickness;
      context.setLineDash(dashes);
      traceBody(context, length, width);
      context.stroke();
      context.setLineDash([]);
    };
    if (name === "neutral" || name === "adversarial") {
      stroke(colours.neutral, name === "neutral" ? thin : thick);
    }
    if (name === "adversarial") stroke(colours.adversarial, thick, [1.6 * thick, 1.1 * thick]);
    if (name === "cooperative") stroke(colours.cooperative, thick);
    if (name === "external") {
      stroke(colours.external, 1.6 * thick);
      stroke(colours.neutral, 0.5 * thick);
    }
  }

  drawBrakes(context, colours, length, width) {
    context.fillStyle = colours.brake_light;
    const size = Math.max(1.5, 0.26 * width);
    const depth = Math.max(1.5, 0.07 * length);
    for (const side of [-1, 1]) {
      context.fillRect(-length / 2 - 0.3 * depth, side * 0.34 * width - size / 2, depth, size);
    }
  }

  drawIndicator(context, colours, length, width, turn) {
    context.fillStyle = colours.indicator;
    const size = Math.max(2.5, 0.3 * width);
    const side = -turn * (width / 2);
    for (const end of [-0.42, 0.42]) {
      context.fillRect(end * length - size / 2, side - size / 2, size, size);
    }
  }

  drawCross(context, colours, length) {
    context.strokeStyle = colours.external;
    context.lineWidth = Math.max(2, 0.06 * length);
    context.beginPath();
    for (const side of [-1, 1]) {
      context.moveTo(-0.45 * length, side * 0.45 * length);
      context.lineTo(0.45 * length, -side * 0.45 * length);
    }
    context.stroke();
  }

  drawRing(context, colours, scene, i) {
    this.withinCar(context, scene, i, (length, width) => {
      context.strokeStyle = colours.marking;
      context.lineWidth = 1.5;
      context.beginPath();
      context.roundRect(-length / 2 - 4, -width / 2 - 4, length + 8, width + 8, 6);
      context.stroke();
    });
  }

  /** The gap in the target lane, between the vehicles that the rule looks at. */
  drawGap(context, colours, scene, i) {
    if (this.names.phase[scene.value("phase", i)] === "absent") return;
    const { camera, header } = this;
    const half = this.body(scene, i).length / 2;
    const ends = [
      [scene.find(scene.value("target_follower", i)), 0.5, -camera.span],
      [scene.find(scene.value("target_leader", i)), -0.5, camera.span],
    ].map(([j, end, far]) =>
      j >= 0 ? scene.position[j] + end * this.body(scene, j).length : scene.position[i] + far,
    );
    const lane = scene.value("target_lane", i);
    const low = (lane + 0.15) * header.lane_width;
    const high = (lane + 0.85) * header.lane_width;
    if (ends[1] <= ends[0]) return;
    const isEngaged = this.names.phase[scene.value("phase", i)] === "engaged";
    context.fillStyle = isEngaged ? colours.safe_gap : colours.refused_gap;
    context.globalAlpha = 0.45;
    camera.trace(context, ends[0], ends[1], low, high);
    context.fill();
    context.globalAlpha = 1;
    if (!isEngaged) this.hatch(context, colours);
    if (scene.find(scene.value("target_follower", i)) >= 0 && scene.find(scene.value("target_leader", i)) >= 0) {
      const body = [scene.position[i] - half, scene.position[i] + half];
      this.writeLength(context, colours, ends, body, 0.5 * (low + high));
    }
  }

  /** A refused gap is hatched, so that colour alone does not tell. */
  hatch(context, colours) {
    const { width, height } = this.camera;
    context.save();
    context.clip();
    context.strokeStyle = colours.refused_gap;
    context.lineWidth = 2;
    context.beginPath();
    for (let x = -height; x < width; x += 12) {
      context.moveTo(x, height);
      context.lineTo(x + height, 0);
    }
    context.stroke();
    context.restore();
  }

  /** In the larger part that is in sight, ahead of the changer or behind it. */
  writeLength(context, colours, ends, body, lateral) {
    const { camera } = this;
    const length = ends[1] - ends[0];
    if (length * camera.scale < 60) return;
    const half = 0.5 * camera.span - 30 / camera.scale;
    const first = Math.max(ends[0], camera.position - half);
    const last = Math.min(ends[1], camera.position + half);
    const isAhead = last - body[1] >= body[0] - first;
    const middle = isAhead ? 0.5 * (Math.max(first, body[1]) + last) : 0.5 * (first + Math.min(last, body[0]));
    const point = camera.project(middle, lateral, this.point);
    context.font = "600 13px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineWidth = 4;
    context.strokeStyle = colours.road;
    context.fillStyle = colours.marking;
    context.strokeText(`${length.toFixed(1)} m`, point.x, point.y);
    context.fillText(`${length.toFixed(1)} m`, point.x, point.y);
  }

  /** The vehicle at a pixel of the canvas, or -1. */
  pick(scene, x, y) {
    let nearest = -1;
    let least = Infinity;
    for (let i = 0; i < scene.count; i += 1) {
      const point = this.camera.project(scene.position[i], scene.lateral[i], this.point);
      const distance = Math.hypot(point.x - x, point.y - y);
      const reach = Math.max(14, 0.55 * this.body(scene, i).length * this.camera.scale);
      if (distance < Math.min(least, reach)) {
        least = distance;
        nearest = scene.vehicle[i];
      }
    }
    return nearest;
  }
}
