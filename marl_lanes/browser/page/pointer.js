// Mouse and touch on the road: click a vehicle, drag the road, zoom by wheel or two fingers.

/** [px] A pointer that moves less has clicked. */
const CLICK = 5;

export class Pointer {
  constructor(player) {
    this.player = player;
    this.canvas = player.canvas;
    this.down = new Map();
    this.hasMoved = false;
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointercancel", (event) => this.down.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => this.turn(event), { passive: false });
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    if (!this.down.size) {
      this.hasMoved = false;
      this.start = this.place(event);
    }
    this.down.set(event.pointerId, this.place(event));
  }

  move(event) {
    const { camera, selection } = this.player;
    const before = this.down.get(event.pointerId);
    const now = this.place(event);
    if (!before) {
      const over = this.player.cars.pick(this.player.scene, now.x, now.y);
      this.canvas.classList.toggle("over", over >= 0);
      return;
    }
    const spread = this.spread();
    if (Math.hypot(now.x - this.start.x, now.y - this.start.y) > CLICK) this.hasMoved = true;
    this.down.set(event.pointerId, now);
    if (this.down.size === 2) {
      this.hasMoved = true;
      if (spread > 0) camera.zoom(this.spread() / spread);
    } else if (this.hasMoved) {
      if (selection.isFollowing) selection.setFollowing(false);
      camera.moveTo(camera.position - (now.x - before.x) / camera.scale);
    }
    this.player.invalidate();
  }

  /** The distance of two fingers. */
  spread() {
    const [a, b] = [...this.down.values()];
    return b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  }

  release(event) {
    this.down.delete(event.pointerId);
    if (this.hasMoved || this.down.size) return;
    const { player } = this;
    const { x, y } = this.place(event);
    const vehicle = player.cars.pick(player.scene, x, y);
    if (vehicle >= 0) player.selection.choose(vehicle, player.scene.step);
  }

  turn(event) {
    event.preventDefault();
    const { camera, selection } = this.player;
    const x = selection.isFollowing ? undefined : this.place(event).x;
    camera.zoom(Math.exp(-0.0015 * event.deltaY), x);
    this.player.invalidate();
  }
}
