// Which vehicle is looked at: chosen by hand, or the changer of the present maneuver.

/** [s] A maneuver stays selected for this long after its end. */
const LINGER = 1.5;

/** Event: "change". */
export class Selection extends EventTarget {
  constructor(store) {
    super();
    this.store = store;
    this.vehicle = -1;
    /** Its maneuver, of findManeuvers, that is nearest to the present; null if it has none. */
    this.maneuver = null;
    this.isAuto = true;
    this.isFollowing = true;
    this.maneuvers = [];
  }

  setManeuvers(maneuvers) {
    this.maneuvers = maneuvers;
  }

  /** Choose a vehicle by hand; the maneuver if it is known. */
  choose(vehicle, step, maneuver = this.nearest(vehicle, step)) {
    this.isAuto = false;
    this.isFollowing = true;
    this.set(vehicle, maneuver);
  }

  setAuto(isAuto) {
    this.isAuto = isAuto;
    if (isAuto) this.isFollowing = true;
    this.dispatchEvent(new Event("change"));
  }

  setFollowing(isFollowing) {
    this.isFollowing = isFollowing;
    this.dispatchEvent(new Event("change"));
  }

  /** Keep up with the scene. */
  update(scene) {
    if (!this.isAuto) {
      const maneuver = this.nearest(this.vehicle, scene.step);
      if (maneuver !== this.maneuver) this.set(this.vehicle, maneuver);
      return;
    }
    const linger = LINGER / this.store.timeStep;
    const now = this.maneuver;
    const isOn = scene.find(this.vehicle) >= 0;
    if (now && isOn && scene.step >= now.firstStep && scene.step <= now.lastStep + linger) return;
    const next = this.present(scene.step);
    if (next) {
      if (next !== now) this.set(next.vehicle, next);
    } else if (!isOn && scene.count) {
      const vehicle = this.middle(scene);
      this.set(vehicle, this.nearest(vehicle, scene.step));
    }
  }

  /** The maneuver at a step; those that are engaged first, then the newest. */
  present(step) {
    let best = null;
    for (const one of this.maneuvers) {
      if (one.firstStep > step) break;
      if (one.lastStep < step) continue;
      const isEngaged = one.engagedStep !== null && one.engagedStep <= step;
      if (!best || isEngaged) best = one;
    }
    return best;
  }

  /** The maneuver of a vehicle that is nearest to a step, or null. */
  nearest(vehicle, step) {
    let best = null;
    let least = Infinity;
    for (const one of this.maneuvers) {
      if (one.vehicle !== vehicle) continue;
      const distance = Math.max(one.firstStep - step, step - one.lastStep, 0);
      if (distance < least) {
        least = distance;
        best = one;
      }
    }
    return best;
  }

  /** Without a maneuver: the vehicle nearest to the middle of the road. */
  middle(scene) {
    let best = 0;
    const middle = this.store.header.road_length / 2;
    for (let i = 1; i < scene.count; i += 1) {
      const is = Math.abs(scene.position[i] - middle);
      if (is < Math.abs(scene.position[best] - middle)) best = i;
    }
    return scene.vehicle[best];
  }

  set(vehicle, maneuver) {
    this.vehicle = vehicle;
    this.maneuver = maneuver;
    this.dispatchEvent(new Event("change"));
  }
}
