// Keys, and their list in the help.

/** Elements that use these keys themselves. */
const OWN = "input, select, textarea, dialog[open]";

export class Keyboard {
  constructor(player) {
    const { clock, camera, selection, transport, theme } = player;
    const refreshing = (change) => () => {
      change();
      player.invalidate();
    };
    this.keys = [
      [[" "], "Space", "play or pause", () => clock.toggle()],
      [["ArrowLeft"], "←", "one step back", () => transport.step(-1)],
      [["ArrowRight"], "→", "one step forward", () => transport.step(1)],
      [["ArrowUp"], "↑", "faster", () => clock.changeSpeed(1)],
      [["ArrowDown"], "↓", "slower", () => clock.changeSpeed(-1)],
      [["Home"], "Home", "to the start", () => clock.seek(clock.first)],
      [["End"], "End", "to the end", () => clock.seek(clock.last)],
      [["["], "[", "previous event", () => player.showNeighbor(-1)],
      [["]"], "]", "next event", () => player.showNeighbor(1)],
      [["+", "="], "+", "zoom in", refreshing(() => camera.zoom(1.25))],
      [["-"], "−", "zoom out", refreshing(() => camera.zoom(0.8))],
      [["f"], "f", "follow the selected vehicle, or not", () => selection.setFollowing(!selection.isFollowing)],
      [["m"], "m", "follow one maneuver after the other, or not", () => selection.setAuto(!selection.isAuto)],
      [["d"], "d", "dark or light", () => theme.toggle()],
      [["?"], "?", "this help", () => player.help.open()],
    ];
    player.page.addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest(OWN)) return;
    // Space presses the button that has the focus.
    if (event.key === " " && event.target.closest("button")) return;
    const found = this.keys.find(([keys]) => keys.includes(event.key));
    if (!found) return;
    event.preventDefault();
    found[3]();
  }
}
