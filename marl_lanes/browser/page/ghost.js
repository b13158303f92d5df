// The optimum of the selected maneuver on the road: its path, and a ghost of the car.

export class Ghost {
  constructor(camera, cars, store) {
    this.camera = camera;
    this.cars = cars;
    this.store = store;
  }

  draw(context, colours, scene, maneuver, optimum) {
    if (!maneuver || !optimum || optimum.first_step === undefined) return;
    const first = optimum.first_step;
    const last = first + optimum.position.length - 1;
    const now = scene.time / this.store.timeStep;
    if (now < maneuver.firstStep || now > Math.max(last, maneuver.lastStep) + 10) return;
    this.drawDriven(context, colours, maneuver, first);
    this.drawPath(context, colours, optimum);
    if (now < first || now > last) return;
    this.store.visit(maneuver.vehicle, first, first, ({ columns }, row) => {
      const body = this.store.header.bodies[columns.profile[row]];
      this.drawCar(context, colours, body, optimum, now - first);
    });
  }

  drawPath(context, colours, optimum) {
    context.strokeStyle = colours.external;
    context.setLineDash([7, 5]);
    this.trace(context, optimum.position.length, (i) => [
      optimum.position[i],
      optimum.lateral_position[i],
    ]);
    context.setLineDash([]);
  }

  drawDriven(context, colours, maneuver, first) {
    const places = [];
    this.store.visit(maneuver.vehicle, first, maneuver.lastStep, ({ columns }, row) => {
      places.push([columns.position[row], columns.lateral_position[row]]);
    });
    context.strokeStyle = colours.changer;
    this.trace(context, places.length, (i) => places[i]);
  }

  trace(context, count, place) {
    context.lineWidth = 2;
    context.beginPath();
    for (let i = 0; i < count; i += 1) {
      const [position, lateral] = place(i);
      this.camera.vertex(context, position, lateral, i === 0);
    }
    context.stroke();
  }

  drawCar(context, colours, body, optimum, index) {
    const before = Math.min(Math.floor(index), optimum.position.length - 2);
    const share = index - before;
    const at = (values) => values[before] + share * (values[before + 1] - values[before]);
    const { position, lateral_position: lateral, yaw } = optimum;
    this.cars.within(context, body, at(position), at(lateral), at(yaw), (length, width) => {
      context.strokeStyle = colours.external;
      context.lineWidth = 2;
      context.setLineDash([4, 3]);
      context.beginPath();
      context.roundRect(-length / 2, -width / 2, length, width, 0.2 * width);
      context.stroke();
      context.setLineDash([]);
    });
  }
}
