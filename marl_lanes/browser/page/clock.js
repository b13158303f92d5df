// The time that is shown: playing, speed, seeking.

export const SPEEDS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];

/** Time of the road [s], which runs while playing. Events: "seek", "state". */
export class Clock extends EventTarget {
  constructor() {
    super();
    this.time = 0;
    this.first = 0;
    this.last = 0;
    this.speed = 1;
    this.isPlaying = false;
    /** Whether more will come: at the last time it then waits, and does not end. */
    this.isOpen = false;
    /** Of the speed: how a stream keeps its distance from the newest. */
    this.pace = 1;
    this.before = null;
  }

  /** The times between which it runs [s]. */
  setBounds(first, last) {
    this.first = first;
    this.last = last;
    this.time = Math.min(Math.max(this.time, first), last);
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.first), this.last);
    this.dispatchEvent(new Event("seek"));
  }

  play() {
    if (this.time >= this.last && !this.isOpen) this.time = this.first;
    this.setPlaying(true);
  }

  pause() {
    this.setPlaying(false);
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  setPlaying(isPlaying) {
    this.isPlaying = isPlaying;
    this.before = null;
    this.dispatchEvent(new Event("state"));
  }

  setSpeed(speed) {
    this.speed = Math.min(Math.max(speed, SPEEDS[0]), SPEEDS.at(-1));
    this.dispatchEvent(new Event("state"));
  }

  /** The next faster or slower speed; direction 1 or -1. */
  changeSpeed(direction) {
    const faster = SPEEDS.filter((speed) => direction * (speed - this.speed) > 1e-9);
    if (faster.length) this.setSpeed(direction > 0 ? faster[0] : faster.at(-1));
  }

  /** Advance to the browser's time of a frame [ms]; whether the shown time has changed. */
  tick(now) {
    if (!this.isPlaying) return false;
    const passed = this.before === null ? 0 : (now - this.before) / 1000;
    this.before = now;
    this.time = Math.min(this.time + passed * this.speed * this.pace, this.last);
    if (this.time >= this.last && !this.isOpen) this.pause();
    return true;
  }
}
