// The address's fragment: where a link starts, and where one is.

/** [ms] The fragment is not written more often, because browsers limit it. */
const PAUSE = 500;

export class Fragment {
  constructor(player) {
    this.player = player;
    this.written = "";
    this.timer = 0;
    window.addEventListener("hashchange", () => this.read());
    const later = () => {
      if (!this.timer) this.timer = window.setTimeout(() => this.write(), PAUSE);
    };
    player.clock.addEventListener("seek", later);
    player.clock.addEventListener("state", later);
    player.selection.addEventListener("change", later);
  }

  /** Go where the fragment says: #command=3, or #t=12.3&vehicle=45. */
  read() {
    const { player } = this;
    const asked = new URLSearchParams(window.location.hash.slice(1));
    player.tell("");
    const command = asked.get("command");
    if (command !== null) {
      const one = player.selection.maneuvers.find((each) => String(each.command) === command);
      if (one) player.showManeuver(one);
      else player.tell(`This replay has no maneuver ${command}.`);
      return;
    }
    const time = Number.parseFloat(asked.get("t"));
    if (Number.isFinite(time)) player.clock.seek(time);
    const vehicle = asked.get("vehicle");
    if (vehicle === null) return;
    if (player.store.spanOf(Number(vehicle))) {
      player.selection.choose(Number(vehicle), player.store.stepAt(player.clock.time));
    } else {
      player.tell(`This replay has no vehicle ${vehicle}.`);
    }
  }

  write() {
    this.timer = 0;
    const { clock, selection } = this.player;
    if (clock.isPlaying) return;
    const vehicle = selection.isAuto ? "" : `&vehicle=${selection.vehicle}`;
    window.history.replaceState(null, "", `#t=${clock.time.toFixed(1)}${vehicle}`);
  }
}
