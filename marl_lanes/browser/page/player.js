// The page: puts its parts together, and draws a frame when something has changed.

import { Camera } from "replay/camera";
import { begin, fit, watchSize } from "replay/canvas";
import { Cars } from "replay/cars";
import { Clock } from "replay/clock";
import { Facts } from "replay/facts";
import { Fragment } from "replay/fragment";
import { Ghost } from "replay/ghost";
import { Help } from "replay/help";
import { Keyboard } from "replay/keyboard";
import { Line } from "replay/line";
import { List } from "replay/list";
import { findManeuvers } from "replay/maneuvers";
import { Overview } from "replay/overview";
import { Plots } from "replay/plots";
import { Pointer } from "replay/pointer";
import { RoadView } from "replay/roadview";
import { Scene } from "replay/scene";
import { Selection } from "replay/selection";
import { Store } from "replay/store";
import { Theme } from "replay/theme";
import { Timeline } from "replay/timeline";
import { Transport } from "replay/transport";

/** [m] The camera goes to a vehicle that is farther away at once. */
const JUMP = 60;

/** What a page shows of one road. A stream appends to `store` and seeks `clock`. */
export class Player {
  constructor(page, header) {
    this.page = page;
    this.element = (id) => page.getElementById(id);
    this.header = header;
    this.store = new Store(header);
    this.clock = new Clock();
    this.theme = new Theme(page.documentElement);
    this.scene = new Scene(this.store);
    this.selection = new Selection(this.store);
    this.camera = new Camera(new Line(header.line), header);
    this.road = new RoadView(this.camera, header);
    this.cars = new Cars(this.camera, header, this.store);
    this.ghost = new Ghost(this.camera, this.cars, this.store);
    this.canvas = this.element("road");
    this.overview = new Overview(this.element("overview"), this.camera, header);
    this.optima = {};
    this.isDirty = true;
    this.before = null;
    this.reduced = window.matchMedia("(prefers-reduced-motion: reduce)");
  }

  /** optima: by command, of browser/optima.py. */
  setOptima(optima) {
    this.optima = optima;
  }

  /** Begin to draw; the store holds the first rows. */
  start() {
    this.writeNames();
    this.transport = new Transport(this);
    this.timeline = new Timeline(this);
    this.list = new List(this);
    this.plots = new Plots(this);
    this.facts = new Facts(this);
    this.help = new Help(this);
    this.pointer = new Pointer(this);
    this.keyboard = new Keyboard(this);
    this.help.setKeys(this.keyboard.keys);
    this.clock.time = this.store.firstTime;
    this.update();
    this.listen();
    this.scene.read(this.clock.time);
    this.selection.update(this.scene);
    this.fragment = new Fragment(this);
    this.fragment.read();
    window.requestAnimationFrame((now) => this.frame(now));
  }

  /** Show another episode of the same road, of which the store has no rows yet. */
  restart(header) {
    this.header = header;
    this.store.header = header;
    this.store.clear();
    this.selection.set(-1, null);
    this.selection.setAuto(true);
    this.writeNames();
  }

  writeNames() {
    const { scenario, policy, seed, road, description } = this.header;
    this.element("title").textContent = scenario;
    this.element("title").title = description;
    this.element("subtitle").textContent = `policy ${policy} · seed ${seed} · road ${road}`;
    this.page.title = `${scenario}: replay`;
  }

  listen() {
    const { element, selection, camera, theme } = this;
    this.store.addEventListener("change", () => this.update());
    for (const part of [this.clock, selection, theme]) {
      for (const kind of ["seek", "state", "change"]) {
        part.addEventListener(kind, () => this.invalidate());
      }
    }
    selection.addEventListener("change", () => this.showSelection());
    watchSize(this.canvas, () => {
      fit(this.canvas);
      camera.resize(this.canvas.clientWidth, this.canvas.clientHeight);
      this.invalidate();
    });
    this.overview.watch(() => {
      fit(this.overview.canvas);
      this.invalidate();
    });
    this.overview.listen((position) => {
      selection.setFollowing(false);
      camera.moveTo(position);
    });
    const zoom = (factor) => {
      camera.zoom(factor);
      this.invalidate();
    };
    element("zoom-in").addEventListener("click", () => zoom(1.25));
    element("zoom-out").addEventListener("click", () => zoom(0.8));
    element("follow").addEventListener("click", () => {
      selection.setFollowing(!selection.isFollowing);
    });
    element("auto").addEventListener("change", (event) => selection.setAuto(event.target.checked));
    element("theme").addEventListener("click", () => theme.toggle());
    element("previous").addEventListener("click", () => this.showNeighbor(-1));
    element("next").addEventListener("click", () => this.showNeighbor(1));
  }

  /** The store has changed. */
  update() {
    this.clock.setBounds(this.store.firstTime, this.store.lastTime);
    this.transport.fit();
    this.selection.setManeuvers(findManeuvers(this.store));
    this.list.update();
    this.plots.rebuild();
  }

  /** Go to an event, and select its vehicle. */
  show(event) {
    const { maneuvers } = this.selection;
    const maneuver = maneuvers.find((one) => one.command === event.command);
    this.selection.choose(event.vehicle, event.step, maneuver);
    this.clock.seek(event.step * this.store.timeStep);
  }

  showManeuver(maneuver) {
    this.selection.choose(maneuver.vehicle, maneuver.firstStep, maneuver);
    this.clock.seek(maneuver.firstStep * this.store.timeStep);
  }

  /** Go to the next event (1) or the one before (-1). */
  showNeighbor(direction) {
    const event = this.timeline.neighbor(direction);
    if (event) this.show(event);
  }

  /** Say something at the top of the page; nothing if the text is empty. */
  tell(text) {
    const message = this.element("message");
    message.textContent = text;
    message.hidden = text === "";
  }

  /** Something that is drawn has changed. */
  invalidate() {
    this.isDirty = true;
  }

  frame(now) {
    const passed = this.before === null ? 0 : Math.min(0.1, (now - this.before) / 1000);
    this.before = now;
    if (this.clock.tick(now) || this.isDirty) {
      this.isDirty = false;
      this.draw(passed);
    }
    window.requestAnimationFrame((next) => this.frame(next));
  }

  draw(passed) {
    const { scene, selection } = this;
    const { colours } = this.theme;
    scene.read(this.clock.time);
    selection.update(scene);
    this.aim(passed);
    const context = begin(this.canvas);
    this.road.draw(context, colours);
    const { maneuver } = selection;
    const optimum = maneuver ? this.optima[maneuver.command] : undefined;
    this.ghost.draw(context, colours, scene, maneuver, optimum);
    this.cars.draw(context, colours, scene, selection.vehicle);
    this.overview.draw(colours, scene, selection.vehicle);
    this.transport.draw();
    this.timeline.draw();
    this.facts.draw(scene);
    this.plots.update();
  }

  /** The selection has changed. */
  showSelection() {
    this.list.mark();
    this.element("follow").setAttribute("aria-pressed", String(this.selection.isFollowing));
    this.element("auto").checked = this.selection.isAuto;
  }

  /** Let the camera follow: glide to a vehicle that is near, jump to one that is far. */
  aim(passed) {
    const i = this.scene.find(this.selection.vehicle);
    if (!this.selection.isFollowing || i < 0) return;
    const position = this.scene.position[i];
    const isTaken = this.taken === this.selection.vehicle;
    const distance = Math.abs(position - this.camera.position);
    if (isTaken || distance < 0.5 || distance > JUMP || this.reduced.matches) {
      this.taken = this.selection.vehicle;
      this.camera.moveTo(position);
      return;
    }
    this.camera.follow(position, passed);
    this.invalidate();
  }
}
