// The maneuvers as rows to click, and the filter.

import { findBrakings } from "replay/maneuvers";

const OUTCOMES = {
  unfinished: "still driving",
  completed: "completed",
  collision: "collision",
  off_road: "off the road",
  missed: "missed",
  timed_out: "timed out",
  horizon: "episode over",
};
/** Rows of hard braking beyond this number are left out, which the page says. */
const MAX_BRAKINGS = 100;

export class List {
  constructor(player) {
    this.player = player;
    const { element } = player;
    this.rows = element("rows");
    this.brakings = element("brakings");
    this.checks = ["only-aborts", "only-failed", "only-braking"].map(element);
    this.threshold = element("threshold");
    this.number = element("num-found");
    this.none = element("none");
    element("filter").addEventListener("input", () => this.update());
    element("filter").addEventListener("submit", (event) => event.preventDefault());
    this.buttons = new Map();
  }

  /** Whether the filter lets a maneuver pass. */
  isFound(one) {
    const [aborts, failed, braking] = this.checks.map((check) => check.checked);
    return (
      (!aborts || one.numAborts > 0) &&
      (!failed || one.outcome !== "completed") &&
      (!braking || one.braking > this.limit)
    );
  }

  /** [m/s^2] */
  get limit() {
    const value = this.threshold.valueAsNumber;
    return Number.isFinite(value) ? Math.max(value, 0.5) : 4;
  }

  /** The maneuvers or the filter have changed. */
  update() {
    const { selection, store, timeline } = this.player;
    const found = selection.maneuvers.filter((one) => this.isFound(one));
    this.number.textContent = `${found.length} of ${selection.maneuvers.length}`;
    this.none.hidden = found.length > 0;
    this.buttons.clear();
    this.rows.replaceChildren(...found.map((one) => this.makeRow(one)));
    const brakings = findBrakings(store, this.limit);
    this.showBrakings(brakings);
    const commands = new Set(found.map((one) => one.command));
    timeline.setEvents(store.events, brakings, (command) => commands.has(command));
    this.mark();
  }

  makeRow(one) {
    const { page, store } = this.player;
    const row = page.createElement("tr");
    const button = page.createElement("button");
    button.type = "button";
    button.textContent = `changer_${one.command}`;
    button.title = `vehicle ${one.vehicle}`;
    row.addEventListener("click", () => this.player.showManeuver(one));
    this.buttons.set(one.command, row);
    const seconds = (step) => (step * store.timeStep).toFixed(1);
    const outcome = page.createElement("span");
    outcome.className = `outcome ${one.outcome}`;
    outcome.textContent = OUTCOMES[one.outcome];
    const cells = [
      button,
      one.direction > 0 ? "left" : "right",
      `${seconds(one.firstStep)} – ${seconds(one.lastStep)}`,
      outcome,
      String(one.numAborts),
      Math.max(0, one.braking).toFixed(1),
    ];
    row.append(
      ...cells.map((content) => {
        const cell = page.createElement("td");
        cell.append(content);
        return cell;
      }),
    );
    return row;
  }

  showBrakings(brakings) {
    const { player } = this;
    const { page, store } = player;
    const items = brakings.slice(0, MAX_BRAKINGS).map((one) => {
      const item = page.createElement("li");
      const button = page.createElement("button");
      button.type = "button";
      const time = (one.step * store.timeStep).toFixed(1);
      button.textContent = `${one.braking.toFixed(1)} m/s², vehicle ${one.vehicle}, ${time} s`;
      button.addEventListener("click", () => player.show({ ...one, kind: "braking" }));
      item.append(button);
      return item;
    });
    this.brakings.replaceChildren(...items);
    const rest = brakings.length - items.length;
    const note = player.element("brakings-note");
    note.textContent = brakings.length
      ? rest > 0
        ? `The ${items.length} hardest of ${brakings.length}.`
        : ""
      : `No vehicle brakes harder than ${this.limit} m/s².`;
  }

  /** Mark the selected maneuver. */
  mark() {
    const { maneuver } = this.player.selection;
    for (const [command, row] of this.buttons) {
      if (maneuver && command === maneuver.command) row.setAttribute("aria-current", "true");
      else row.removeAttribute("aria-current");
    }
  }
}
