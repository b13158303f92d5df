// The events over time: a lane of marks for each kind.

import { KINDS } from "replay/kinds";

/** Marks of hard braking beyond this number, the gentler ones, are not shown. */
const MAX_BRAKINGS = 400;

export class Timeline {
  constructor(player) {
    this.player = player;
    this.lanes = player.element("lanes");
    this.scroller = player.element("scroller");
    this.zoom = player.element("timeline-zoom");
    this.head = player.page.createElement("div");
    this.head.className = "head";
    this.tracks = new Map();
    this.lanes.append(...KINDS.map((kind) => this.makeLane(kind)), this.head);
    this.marks = [];
    this.isZoomed = false;
    this.listen();
  }

  makeLane({ kind, lane: label }) {
    const { page } = this.player;
    const lane = page.createElement("div");
    lane.className = `lane ${kind}`;
    const name = page.createElement("span");
    name.className = "label";
    const number = page.createElement("b");
    name.append(`${label} `, number);
    const track = page.createElement("div");
    track.className = "track";
    lane.append(name, track);
    this.tracks.set(kind, { lane, track, number });
    return lane;
  }

  listen() {
    this.lanes.addEventListener("click", (event) => {
      const mark = this.marks.find((one) => one.button === event.target);
      if (mark) this.player.show(mark.event);
    });
    let isDown = false;
    const seek = (event) => {
      const box = this.tracks.get("command").track.getBoundingClientRect();
      const { clock } = this.player;
      clock.seek(clock.first + ((event.clientX - box.left) / box.width) * (clock.last - clock.first));
    };
    this.lanes.addEventListener("pointerdown", (event) => {
      if (event.target.tagName === "BUTTON" || event.target.closest(".label")) return;
      isDown = event.pointerType === "mouse";
      seek(event);
    });
    this.lanes.addEventListener("pointermove", (event) => isDown && seek(event));
    window.addEventListener("pointerup", () => {
      isDown = false;
    });
    this.zoom.addEventListener("change", () => this.resize());
  }

  /** Show marks; brakings: of maneuvers.findBrakings; isFound(command): as the filter says. */
  setEvents(events, brakings, isFound) {
    const hardest = brakings.slice(0, MAX_BRAKINGS).map((one) => ({ ...one, kind: "braking" }));
    const all = [...events, ...hardest].sort((a, b) => a.step - b.step);
    this.marks = all.map((event) => ({ event, button: this.makeMark(event, isFound) }));
    for (const { kind, lane: label, isAlways } of KINDS) {
      const { lane, track, number } = this.tracks.get(kind);
      const here = this.marks.filter((mark) => mark.event.kind === kind);
      track.replaceChildren(...here.map((mark) => mark.button));
      const count = kind === "braking" ? brakings.length : here.length;
      number.textContent = String(count);
      lane.hidden = !isAlways && !count;
      lane.title = count > here.length ? `${label}: the ${here.length} hardest of ${count}` : "";
    }
    this.resize();
  }

  makeMark(event, isFound) {
    const { store, page } = this.player;
    const button = page.createElement("button");
    button.type = "button";
    button.className = `mark ${event.kind}`;
    const isCommanded = event.command !== null && event.command !== undefined;
    if (isCommanded && !isFound(event.command)) button.classList.add("dim");
    const who = isCommanded ? `changer_${event.command}` : `vehicle ${event.vehicle}`;
    const time = (event.step * store.timeStep).toFixed(1);
    const other = event.other === null || event.other === undefined ? "" : ` with ${event.other}`;
    const how = event.braking === undefined ? "" : `, ${event.braking.toFixed(1)} m/s²`;
    button.title = `${KINDS.find((one) => one.kind === event.kind).words} of ${who}${other}, ${time} s${how}`;
    button.setAttribute("aria-label", button.title);
    // [ and ] go from mark to mark, so that Tab need not.
    button.tabIndex = -1;
    const share = (event.step - store.firstStep) / Math.max(1, store.lastStep - store.firstStep);
    button.style.left = `${100 * share}%`;
    return button;
  }

  /** Width by the chosen span of time. */
  resize() {
    const { clock } = this.player;
    const span = Number(this.zoom.value);
    const zoom = span ? Math.max(1, (clock.last - clock.first) / span) : 1;
    this.isZoomed = zoom > 1;
    this.lanes.style.setProperty("--zoom", String(zoom));
    this.reveal();
  }

  /** The share of the time that has passed. */
  get share() {
    const { clock } = this.player;
    return (clock.time - clock.first) / Math.max(1e-9, clock.last - clock.first);
  }

  /** Scroll to where the present is seen. */
  reveal() {
    const { scroller, head } = this;
    const width = scroller.clientWidth;
    if (scroller.scrollWidth <= width) return;
    const at = head.offsetLeft + this.share * head.offsetWidth;
    const x = at - scroller.scrollLeft;
    if (x < 0.25 * width || x > 0.9 * width) scroller.scrollLeft = at - 0.4 * width;
  }

  draw() {
    this.head.style.transform = `translateX(${100 * this.share}%)`;
    if (this.player.clock.isPlaying && this.isZoomed) this.reveal();
  }

  /** The nearest event after (direction 1) or before (-1) the present, or undefined. */
  neighbor(direction) {
    const { clock, store } = this.player;
    const now = clock.time / store.timeStep;
    const events = this.marks.map((mark) => mark.event);
    if (direction > 0) return events.find((event) => event.step > now + 1e-6);
    return events.findLast((event) => event.step < now - 1e-6);
  }
}
