// The selected vehicle's state in words and numbers, over the road.

export class Facts {
  constructor(player) {
    this.player = player;
    this.box = player.element("facts");
    const { page } = player;
    this.name = page.createElement("strong");
    this.line = page.createElement("span");
    this.more = page.createElement("span");
    this.more.className = "more";
    this.box.append(this.name, this.line, this.more);
  }

  draw(scene) {
    const { selection, store } = this.player;
    const i = scene.find(selection.vehicle);
    if (i < 0) {
      this.write(`vehicle ${selection.vehicle}`, "not on the road", "");
      return;
    }
    const value = (name) => scene.value(name, i);
    const named = (name) => store.names(name)[value(name)];
    const signed = (number, digits) =>
      `${number < 0 ? "−" : "+"}${Math.abs(number).toFixed(digits)}`;
    const motion = `${value("speed").toFixed(1)} m/s, ${signed(value("acceleration"), 2)} m/s²`;
    const place = `at ${scene.position[i].toFixed(0)} m`;
    const command = value("command");
    if (command < 0) {
      const what = `${named("disposition")} driver`;
      this.write(`vehicle ${selection.vehicle}`, `${motion}`, `${what}, ${place}`);
      return;
    }
    const outcome = named("outcome");
    const state = outcome === "unfinished" ? named("phase") : outcome.replace("_", " ");
    const way = value("direction") > 0 ? "to the left" : "to the right";
    const { lane_width: width } = store.header;
    const left = Math.abs((value("target_lane") + 0.5) * width - scene.lateral[i]).toFixed(2);
    this.write(
      `changer_${command}: ${state}`,
      `${way}, ${motion}`,
      `${left} m from the target lane's centre, ${place}`,
    );
  }

  write(name, line, more) {
    this.name.textContent = name;
    this.line.textContent = line;
    this.more.textContent = more;
  }
}
