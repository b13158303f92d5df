// Play, pause, steps, speed, and the slider of time.

import { SPEEDS } from "replay/clock";

export class Transport {
  constructor(player) {
    this.player = player;
    this.clock = player.clock;
    this.time = player.element("time");
    this.scrub = player.element("scrub");
    this.play = player.element("play");
    this.speed = player.element("speed");
    for (const speed of SPEEDS) this.speed.add(new Option(`${speed}×`, String(speed)));
    this.listen();
  }

  listen() {
    const { clock, player } = this;
    this.play.addEventListener("click", () => clock.toggle());
    player.element("back").addEventListener("click", () => this.step(-1));
    player.element("forward").addEventListener("click", () => this.step(1));
    this.scrub.addEventListener("input", () => clock.seek(Number(this.scrub.value)));
    this.speed.addEventListener("change", () => clock.setSpeed(Number(this.speed.value)));
    clock.addEventListener("state", () => this.show());
    this.show();
  }

  /** Pause, and go to the step before or after. */
  step(direction) {
    const { clock } = this;
    const { store } = this.player;
    clock.pause();
    const now = clock.time / store.timeStep;
    const step = direction > 0 ? Math.floor(now + 1e-6) + 1 : Math.ceil(now - 1e-6) - 1;
    clock.seek(step * store.timeStep);
  }

  show() {
    const { clock } = this;
    this.play.classList.toggle("playing", clock.isPlaying);
    this.play.setAttribute("aria-label", clock.isPlaying ? "Pause" : "Play");
    this.speed.value = String(clock.speed);
  }

  /** The bounds of time have changed. */
  fit() {
    this.scrub.min = String(this.clock.first);
    this.scrub.max = String(this.clock.last);
  }

  draw() {
    const { clock } = this;
    this.scrub.value = String(clock.time);
    const time = clock.time.toFixed(1);
    if (time === this.shown) return;
    this.shown = time;
    this.time.textContent = `${time} / ${clock.last.toFixed(1)} s`;
    this.scrub.setAttribute("aria-valuetext", `${time} seconds`);
  }
}
