// What the plots show of a vehicle: lines over time, with their units.

/** Values at times; NaN breaks the line. */
class Series {
  constructor(name) {
    this.name = name;
    this.times = [];
    this.values = [];
  }

  add(time, value) {
    this.times.push(time);
    this.values.push(value);
  }

  /** The value at a time: that of the last sample at or before it, NaN outside. */
  at(time, step) {
    let low = 0;
    let high = this.times.length - 1;
    if (high < 0 || time < this.times[0] - 1e-9 || time > this.times[high] + step) return NaN;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    return this.values[low];
  }

  get isEmpty() {
    return !this.values.some(Number.isFinite);
  }
}

const TERM = "reward_";

/** The plots of a vehicle between two steps: [{key, title, unit, lines}]. */
export function makePlots(store, optimum, vehicle, firstStep, lastStep) {
  const { header, timeStep } = store;
  const unitOf = (name) => header.columns.find((column) => column.name === name).unit;
  const terms = header.columns.map((column) => column.name).filter((name) => name.startsWith(TERM));
  const make = (key, title, unit, names) => ({
    key,
    title,
    unit,
    lines: names.map((name) => new Series(name)),
  });
  const plots = {
    speed: make("speed", "Speed", unitOf("speed"), ["vehicle", "leader"]),
    gaps: make("gaps", "Gaps", unitOf("position"), ["leader", "target leader", "target follower"]),
    acceleration: make("acceleration", "Acceleration", unitOf("acceleration"), [
      "vehicle",
      "target follower",
    ]),
    lateral: make("lateral", "Lateral position", unitOf("lateral_position"), ["driven", "optimum"]),
    yawRate: make("yawRate", "Yaw rate", unitOf("yaw_rate"), ["driven", "optimum"]),
    yawAcceleration: make("yawAcceleration", "Yaw acceleration", unitOf("yaw_acceleration"), [
      "driven",
      "optimum",
    ]),
    reward: make("reward", "Reward terms", "per step", terms.map((name) => label(name))),
  };
  store.visit(vehicle, firstStep, lastStep, (chunk, row) => {
    const { columns } = chunk;
    const step = columns.step[row];
    const time = step * timeStep;
    const isCommanded = columns.command[row] >= 0;
    const near = (name) => (isCommanded ? place(chunk, columns[name][row], step) : -1);
    const leader = isCommanded ? near("leader") : ahead(chunk, row);
    const targetLeader = near("target_leader");
    const targetFollower = near("target_follower");
    const gap = (other) => {
      if (other < 0) return NaN;
      const distance = Math.abs(columns.position[other] - columns.position[row]);
      const [own, others] = [row, other].map((at) => header.bodies[columns.profile[at]].length);
      return distance - 0.5 * (own + others);
    };
    const value = (name, other) => (other < 0 ? NaN : columns[name][other]);
    plots.speed.lines[0].add(time, columns.speed[row]);
    plots.speed.lines[1].add(time, value("speed", leader));
    plots.gaps.lines[0].add(time, gap(leader));
    plots.gaps.lines[1].add(time, gap(targetLeader));
    plots.gaps.lines[2].add(time, gap(targetFollower));
    plots.acceleration.lines[0].add(time, columns.acceleration[row]);
    plots.acceleration.lines[1].add(time, value("acceleration", targetFollower));
    plots.lateral.lines[0].add(time, columns.lateral_position[row]);
    plots.yawRate.lines[0].add(time, columns.yaw_rate[row]);
    plots.yawAcceleration.lines[0].add(time, columns.yaw_acceleration[row]);
    terms.forEach((name, i) => plots.reward.lines[i].add(time, columns[name][row]));
  });
  if (optimum && optimum.first_step !== undefined) addOptimum(plots, optimum, timeStep);
  for (const plot of Object.values(plots)) plot.lines = plot.lines.filter((line) => !line.isEmpty);
  return Object.values(plots);
}

function label(name) {
  return name.slice(TERM.length).replace("_", " ");
}

function addOptimum(plots, optimum, timeStep) {
  optimum.position.forEach((_, i) => {
    const time = (optimum.first_step + i) * timeStep;
    plots.lateral.lines[1].add(time, optimum.lateral_position[i]);
    plots.yawRate.lines[1].add(time, optimum.yaw_rate[i]);
    // That of the first entry was not chosen by the optimum.
    if (i > 0) plots.yawAcceleration.lines[1].add(time, optimum.yaw_acceleration[i]);
  });
}

function place(chunk, vehicle, step) {
  return vehicle < 0 ? -1 : chunk.find(vehicle, step);
}

/** The row of the next vehicle ahead in the lane, at the same step, or -1. */
function ahead(chunk, row) {
  const { position, lane, lane_low: low, lane_high: high, step } = chunk.columns;
  let nearest = -1;
  for (const other of chunk.rowsAt(step[row])) {
    const isIn = low[other] <= lane[row] && high[other] >= lane[row];
    const isAhead = other !== row && position[other] > position[row];
    if (isIn && isAhead && (nearest < 0 || position[other] < position[nearest])) nearest = other;
  }
  return nearest;
}
