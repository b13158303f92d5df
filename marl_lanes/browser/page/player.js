// The page: puts its parts together, and draws a frame when something has changed.

import { Camera } from "replay/camera";
import { begin, fit, watchSize } from "replay/canvas";
import { Cars } from "replay/cars";
import { Clock } from "replay/clock";
import { Line } from "replay/line";
import { findManeuvers } from "replay/maneuvers";
import { Overview } from "replay/overview";
import { RoadView } from "replay/roadview";
import { Scene } from "replay/scene";
import { Selection } from "replay/selection";
import { Store } from "replay/store";
import { Theme } from "replay/theme";
import { Transport } from "replay/transport";

/** What a page shows of one road. A stream appends to `store` and seeks `clock`. */
export class Player {
  constructor(page, header) {
    this.page = page;
    this.element = (id) => page.getElementById(id);
    this.header = header;
    this.store = new Store(header);
    this.clock = new Clock();
    this.theme = new Theme(page.documentElement);
    this.line = new Line(header.line);
    this.camera = new Camera(this.line, header);
    this.scene = new Scene(this.store);
    this.selection = new Selection(this.store);
    this.road = new RoadView(this.camera, header);
    this.cars = new Cars(this.camera, header, this.store);
    this.canvas = this.element("road");
    this.overview = new Overview(this.element("overview"), this.camera, header);
    this.optima = {};
    this.isDirty = true;
    this.isStarted = false;
  }

  setOptima(optima) {
    this.optima = optima;
  }

  /** Begin to draw; the store holds the first rows. */
  start() {
    this.writeNames();
    this.transport = new Transport(this);
    this.store.addEventListener("change", () => this.update());
    this.update();
    this.clock.seek(this.store.firstTime);
    for (const part of [this.clock, this.selection, this.theme]) {
      for (const kind of ["seek", "state", "change"]) {
        part.addEventListener(kind, () => this.invalidate());
      }
    }
    watchSize(this.canvas, () => {
      fit(this.canvas);
      this.camera.resize(this.canvas.clientWidth, this.canvas.clientHeight);
      this.invalidate();
    });
    this.overview.watch(() => {
      fit(this.overview.canvas);
      this.invalidate();
    });
    this.overview.listen((position) => {
      this.selection.setFollowing(false);
      this.camera.moveTo(position);
    });
    this.isStarted = true;
    this.before = null;
    window.requestAnimationFrame((now) => this.frame(now));
  }

  writeNames() {
    const { scenario, policy, seed, road } = this.header;
    this.element("title").textContent = scenario;
    this.element("subtitle").textContent = `policy ${policy} · seed ${seed} · road ${road}`;
    this.page.title = `${scenario}: replay`;
  }

  /** The store has changed. */
  update() {
    this.clock.setBounds(this.store.firstTime, this.store.lastTime);
    this.selection.setManeuvers(findManeuvers(this.store));
    this.invalidate();
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
    const { scene, camera, selection } = this;
    const { colours } = this.theme;
    scene.read(this.clock.time);
    selection.update(scene);
    this.aim(passed);
    const context = begin(this.canvas);
    this.road.draw(context, colours);
    this.cars.draw(context, colours, scene, selection.vehicle);
    this.overview.draw(colours, scene, selection.vehicle);
    this.transport.draw();
  }

  aim(passed) {
    const i = this.scene.find(this.selection.vehicle);
    if (!this.selection.isFollowing || i < 0) return;
    this.camera.follow(this.scene.position[i], passed, true);
  }
}
