// The help: what colours and shapes mean, and the keys.

import { KINDS } from "replay/kinds";

const VEHICLES = [
  ["body changer", "a vehicle with a lane-change command"],
  ["body other", "any other vehicle"],
  ["body other cooperative", "cooperative driver: makes room"],
  ["body other neutral", "neutral driver: does not react"],
  ["body other adversarial", "adversarial driver: closes the gap"],
  ["body other external", "driver with a policy of its own"],
  ["light indicator", "indicator"],
  ["light brake", "brake lights"],
  ["gap refused", "the gap that the changer waits for"],
  ["gap safe", "the gap that it has accepted"],
  ["path driven", "path of the selected changer"],
  ["path optimum", "path of the optimum; its car is dashed, too"],
];
export class Help {
  constructor(player) {
    this.page = player.page;
    this.dialog = player.element("help");
    const legend = player.element("legend");
    legend.append(...VEHICLES.map(([look, text]) => this.makeItem(`sample ${look}`, text)));
    legend.append(...KINDS.map(({ kind, words }) => this.makeItem(`mark ${kind}`, words)));
    player.element("show-help").addEventListener("click", () => this.open());
  }

  makeItem(look, text) {
    const item = this.page.createElement("li");
    const sample = this.page.createElement("span");
    sample.className = look;
    sample.setAttribute("aria-hidden", "true");
    const words = this.page.createElement("span");
    words.textContent = text;
    item.append(sample, words);
    return item;
  }

  /** List the keys: [keys, name, meaning, action]. */
  setKeys(keys) {
    const list = keys.flatMap(([, name, meaning]) => {
      const key = this.page.createElement("dt");
      key.append(Object.assign(this.page.createElement("kbd"), { textContent: name }));
      const means = this.page.createElement("dd");
      means.textContent = meaning;
      return [key, means];
    });
    this.page.getElementById("keys").replaceChildren(...list);
  }

  open() {
    this.dialog.showModal();
  }
}
