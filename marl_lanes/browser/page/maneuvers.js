// The maneuvers and the hard braking that the rows hold.

/** Steps from one braking to the next of the same vehicle that belong together. */
const JOINED = 5;

/** Every command: {command, vehicle, firstStep, lastStep, engagedStep, outcome, numAborts,
 * direction, braking}; braking is the hardest of the changer and of those behind it [m/s^2]. */
export function findManeuvers(store) {
  const outcomes = store.names("outcome");
  const found = new Map();
  for (const chunk of store.chunks) {
    const { columns } = chunk;
    for (let row = 0; row < chunk.numRows; row += 1) {
      const command = columns.command[row];
      if (command < 0) continue;
      const one = found.get(command) ?? begin(command, columns, row);
      found.set(command, one);
      one.lastStep = columns.step[row];
      one.outcome = outcomes[columns.outcome[row]];
      one.numAborts = columns.num_aborts[row];
      one.braking = Math.max(one.braking, hardest(store, chunk, row));
    }
  }
  for (const event of store.events) {
    const one = event.kind === "engaged" ? found.get(event.command) : undefined;
    if (one && one.engagedStep === null) one.engagedStep = event.step;
  }
  return [...found.values()].sort((a, b) => a.firstStep - b.firstStep || a.command - b.command);
}

function begin(command, columns, row) {
  return {
    command,
    vehicle: columns.vehicle[row],
    firstStep: columns.step[row],
    lastStep: columns.step[row],
    engagedStep: null,
    outcome: "unfinished",
    numAborts: 0,
    direction: columns.direction[row],
    braking: 0,
  };
}

/** Of a changer and of the vehicles behind it in both lanes at one step. */
function hardest(store, chunk, row) {
  const { columns } = chunk;
  let braking = -columns.acceleration[row];
  for (const name of ["follower", "target_follower"]) {
    const other = columns[name][row];
    const at = other < 0 ? -1 : chunk.find(other, columns.step[row]);
    if (at >= 0) braking = Math.max(braking, -columns.acceleration[at]);
  }
  return braking;
}

/** Each time that any vehicle brakes harder than the threshold [m/s^2], the hardest first:
 * {step, vehicle, braking}; step is that of the hardest braking. */
export function findBrakings(store, threshold) {
  const found = [];
  for (const chunk of store.chunks) {
    const { acceleration, vehicle, step } = chunk.columns;
    let open = null;
    for (let row = 0; row < chunk.numRows; row += 1) {
      const braking = -acceleration[row];
      if (braking <= threshold) continue;
      const isNew = !open || open.vehicle !== vehicle[row] || step[row] > open.last + JOINED;
      if (isNew) {
        open = { vehicle: vehicle[row], step: step[row], braking, last: step[row] };
        found.push(open);
      } else if (braking > open.braking) {
        open.braking = braking;
        open.step = step[row];
      }
      open.last = step[row];
    }
  }
  return found.sort((a, b) => b.braking - a.braking || a.step - b.step);
}
