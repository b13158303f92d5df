// The plots of the selected vehicle, with one cursor.

import { watchSize } from "replay/canvas";
import { Plot } from "replay/plot";
import { makePlots } from "replay/series";

/** [s] Shown before a command and after its end, or around the present without one. */
const MARGIN = 2;
const AROUND = 15;

export class Plots {
  constructor(player) {
    this.player = player;
    this.grid = player.element("grid");
    this.title = player.element("plots-title");
    this.choice = player.element("plots-window");
    this.note = player.element("optimum");
    this.plots = [];
    this.shown = null;
    this.choice.addEventListener("change", () => this.rebuild());
    player.theme.addEventListener("change", () => this.redraw());
    watchSize(this.grid, () => this.redraw());
    this.listen();
  }

  /** Click or drag in a plot to go to that time. */
  listen() {
    let dragged = null;
    const seek = (event) => {
      const x = event.clientX - dragged.canvas.getBoundingClientRect().left;
      this.player.clock.seek(dragged.timeAt(x, this.window));
    };
    this.grid.addEventListener("pointerdown", (event) => {
      dragged = this.plots.find((plot) => plot.canvas === event.target) ?? null;
      if (!dragged) return;
      dragged.canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.grid.addEventListener("pointermove", (event) => dragged && seek(event));
    for (const end of ["pointerup", "pointercancel"]) {
      this.grid.addEventListener(end, () => {
        dragged = null;
      });
    }
  }

  /** Forget what is shown, so that the next update builds it again. */
  rebuild() {
    this.shown = null;
    this.player.invalidate();
  }

  /** Keep up with selection and time. */
  update() {
    const { selection, clock, store } = this.player;
    const window = this.makeWindow();
    const isSame =
      this.shown &&
      this.shown.vehicle === selection.vehicle &&
      this.shown.maneuver === selection.maneuver &&
      window.first === this.window.first &&
      window.last === this.window.last;
    if (!isSame) this.build(window);
    for (const plot of this.plots) plot.point(clock.time, this.window, store.timeStep);
  }

  /** The time that is shown. */
  makeWindow() {
    const { selection, store, clock } = this.player;
    const { timeStep } = store;
    const [firstStep, lastStep] = store.spanOf(selection.vehicle) ?? [store.firstStep, store.lastStep];
    let first = firstStep * timeStep;
    let last = lastStep * timeStep;
    if (this.choice.value === "maneuver") {
      const one = selection.maneuver;
      const isNear = one && clock.time >= one.firstStep * timeStep - AROUND && clock.time <= one.lastStep * timeStep + AROUND;
      // Without a maneuver near: windows that stand still while time runs through them.
      const turn = Math.floor(clock.time / AROUND) * AROUND;
      first = Math.max(first, isNear ? one.firstStep * timeStep - MARGIN : turn - AROUND / 2);
      last = Math.min(last, isNear ? one.lastStep * timeStep + MARGIN : turn + 1.5 * AROUND);
    }
    return { first, last: Math.max(last, first + 1) };
  }

  build(window) {
    const { selection, store, page, optima } = this.player;
    const { vehicle, maneuver } = selection;
    this.shown = { vehicle, maneuver };
    this.window = window;
    this.title.textContent = maneuver
      ? `changer_${maneuver.command}, vehicle ${vehicle}`
      : `Vehicle ${vehicle}`;
    const optimum = maneuver ? optima[maneuver.command] : undefined;
    this.note.textContent = maneuver ? describe(optimum, maneuver) : "This vehicle has no command.";
    const first = Math.floor(window.first / store.timeStep);
    const last = Math.ceil(window.last / store.timeStep);
    const made = makePlots(store, optimum, vehicle, first, last);
    this.phases = this.findPhases(first, last);
    this.plots = made.filter((data) => data.lines.length).map((data) => new Plot(page, data));
    this.grid.replaceChildren(...this.plots.map((plot) => plot.figure));
    this.redraw();
  }

  redraw() {
    for (const plot of this.plots) plot.draw(this.player.theme.colours, this.window, this.phases);
    this.player.invalidate();
  }

  /** The spans of the vehicle's phases within steps: [{first, last, name}], in seconds. */
  findPhases(firstStep, lastStep) {
    const { store, selection } = this.player;
    const names = store.names("phase");
    const found = [];
    store.visit(selection.vehicle, firstStep, lastStep, (chunk, row) => {
      const name = names[chunk.columns.phase[row]];
      const time = chunk.columns.step[row] * store.timeStep;
      const open = found.at(-1);
      if (open && open.name === name) open.last = time;
      else {
        if (open) open.last = time;
        found.push({ first: time, last: time, name });
      }
    });
    return found.filter((phase) => phase.name !== "absent");
  }
}

/** The costs in words. */
function describe(optimum, maneuver) {
  if (!optimum) return "The optimum was not computed.";
  if (optimum.reason) return `No optimum: ${optimum.reason}.`;
  const ratio = (optimum.driven_cost / optimum.cost).toFixed(3);
  const since = maneuver.numAborts ? " since it last engaged" : "";
  const all = maneuver.numAborts ? ` (${optimum.total_cost.toFixed(2)} with its aborts)` : "";
  return (
    `Cost driven ${optimum.driven_cost.toFixed(2)}${since}${all}, ` +
    `optimum ${optimum.cost.toFixed(2)}: ratio ${ratio}.`
  );
}
