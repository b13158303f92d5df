// The whole road as a strip, straight, with the part that the camera shows.

import { begin, watchSize } from "replay/canvas";

export class Overview {
  constructor(canvas, camera, header) {
    this.canvas = canvas;
    this.camera = camera;
    this.header = header;
  }

  /** Call look(position) when someone clicks or drags on it. */
  listen(look) {
    const { canvas } = this;
    let isDown = false;
    const at = (event) => {
      const share = (event.clientX - canvas.getBoundingClientRect().left) / canvas.clientWidth;
      look(share * this.header.road_length);
    };
    canvas.addEventListener("pointerdown", (event) => {
      isDown = true;
      canvas.setPointerCapture(event.pointerId);
      at(event);
    });
    canvas.addEventListener("pointermove", (event) => isDown && at(event));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => {
        isDown = false;
      });
    }
  }

  watch(resized) {
    watchSize(this.canvas, resized);
  }

  draw(colours, scene, selected) {
    const context = begin(this.canvas);
    const { header, camera } = this;
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    const across = header.num_lanes * header.lane_width;
    const scale = width / header.road_length;
    const lane = height / header.num_lanes;
    context.fillStyle = colours.road;
    context.fillRect(0, 0, width, height);
    context.strokeStyle = colours.marking;
    context.globalAlpha = 0.25;
    context.lineWidth = 1;
    context.beginPath();
    for (let i = 1; i < header.num_lanes; i += 1) {
      context.moveTo(0, i * lane);
      context.lineTo(width, i * lane);
    }
    context.stroke();
    context.globalAlpha = 1;
    const body = Math.min(6, 0.55 * lane);
    for (let i = 0; i < scene.count; i += 1) {
      const isChanger = scene.value("command", i) >= 0;
      const isSelected = scene.vehicle[i] === selected;
      const length = Math.max(4, header.bodies[scene.value("profile", i)].length * scale);
      const x = scene.position[i] * scale;
      const y = height * (1 - scene.lateral[i] / across);
      context.fillStyle = isChanger ? colours.changer : colours.vehicle;
      const grown = isChanger ? 1 : 0;
      context.fillRect(x - length / 2 - grown, y - body / 2 - grown, length + 2 * grown, body + 2 * grown);
      if (isSelected) {
        context.strokeStyle = colours.external;
        context.strokeRect(x - length / 2 - 2.5, y - body / 2 - 2.5, length + 5, body + 5);
      }
    }
    context.strokeStyle = colours.external;
    context.lineWidth = 2;
    const left = (camera.position - camera.span / 2) * scale;
    context.strokeRect(left, 1, camera.span * scale, height - 2);
    context.fillStyle = "rgba(255, 255, 255, 0.1)";
    context.fillRect(left, 0, camera.span * scale, height);
  }
}
