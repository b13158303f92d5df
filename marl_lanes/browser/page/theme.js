// Dark and light, and the colours of the style sheet for what is drawn on a canvas.

const VARIABLES = [
  "background", "panel", "text", "muted", "grid", "link", "warning", "ground", "road", "marking",
  "changer", "vehicle", "cooperative", "neutral", "adversarial", "external", "indicator",
  "brake_light", "safe_gap", "refused_gap",
];
const NUM_SERIES = 6;

/** The colours that hold now. Event: "change". */
export class Theme extends EventTarget {
  constructor(root) {
    super();
    this.root = root;
    this.colours = {};
    this.prefersDark = window.matchMedia("(prefers-color-scheme: dark)");
    this.prefersDark.addEventListener("change", () => this.read());
    this.read();
  }

  get isDark() {
    const chosen = this.root.dataset.theme;
    return chosen ? chosen === "dark" : this.prefersDark.matches;
  }

  toggle() {
    this.root.dataset.theme = this.isDark ? "light" : "dark";
    this.read();
  }

  read() {
    const style = window.getComputedStyle(this.root);
    for (const name of VARIABLES) {
      this.colours[name] = style.getPropertyValue(`--${name.replace("_", "-")}`).trim();
    }
    this.colours.series = Array.from({ length: NUM_SERIES }, (_, i) =>
      style.getPropertyValue(`--series-${i}`).trim(),
    );
    this.dispatchEvent(new Event("change"));
  }
}
