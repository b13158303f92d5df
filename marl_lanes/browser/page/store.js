// The rows of the road, and how to find them: by time step, and by vehicle.

import { checkHeader, decodeChunk } from "replay/decoding";

/** Rows of consecutive steps, ordered by vehicle, then step. */
class Chunk {
  constructor(chunk, columns) {
    this.firstStep = chunk.first_step;
    this.lastStep = chunk.last_step;
    this.numRows = chunk.num_rows;
    this.columns = columns;
    this.events = chunk.events.map(([step, kind, vehicle, command, other]) => ({
      step,
      kind,
      vehicle,
      command,
      other,
    }));
    this.indexSteps();
    this.indexVehicles();
  }

  /** Rows by step, by a counting sort. */
  indexSteps() {
    const { step } = this.columns;
    const numSteps = this.lastStep - this.firstStep + 1;
    this.starts = new Int32Array(numSteps + 1);
    for (let row = 0; row < this.numRows; row += 1) this.starts[step[row] - this.firstStep + 1] += 1;
    for (let k = 0; k < numSteps; k += 1) this.starts[k + 1] += this.starts[k];
    const next = this.starts.slice(0, numSteps);
    this.rows = new Int32Array(this.numRows);
    for (let row = 0; row < this.numRows; row += 1) {
      const k = step[row] - this.firstStep;
      this.rows[next[k]] = row;
      next[k] += 1;
    }
  }

  indexVehicles() {
    const { vehicle } = this.columns;
    this.segments = new Map();
    let start = 0;
    for (let row = 1; row <= this.numRows; row += 1) {
      if (row === this.numRows || vehicle[row] !== vehicle[start]) {
        this.segments.set(vehicle[start], [start, row]);
        start = row;
      }
    }
  }

  /** The rows of a step. */
  rowsAt(step) {
    const k = step - this.firstStep;
    return this.rows.subarray(this.starts[k], this.starts[k + 1]);
  }

  /** The row of a vehicle at a step, or -1. */
  find(vehicle, step) {
    const segment = this.segments.get(vehicle);
    if (segment === undefined) return -1;
    const steps = this.columns.step;
    const row = segment[0] + step - steps[segment[0]];
    return row >= segment[0] && row < segment[1] && steps[row] === step ? row : -1;
  }
}

/** Everything that is known of the road; grows while a stream sends chunks ("change" event). */
export class Store extends EventTarget {
  constructor(header) {
    super();
    checkHeader(header);
    this.header = header;
    this.clear();
  }

  /** Forget all rows, as before another episode. */
  clear() {
    this.chunks = [];
    this.events = [];
    this.firstStep = 0;
    this.lastStep = 0;
  }

  /** Add chunks of the steps after the last one. */
  async append(...chunks) {
    const read = chunks.map((chunk) => decodeChunk(this.header, chunk));
    const decoded = await Promise.all(read);
    chunks.forEach((chunk, i) => {
      const last = this.chunks.at(-1);
      if (last && chunk.first_step <= last.lastStep) {
        throw new Error(`chunk from step ${chunk.first_step}: must be after ${last.lastStep}`);
      }
      this.chunks.push(new Chunk(chunk, decoded[i]));
    });
    this.update();
  }

  update() {
    this.events = this.chunks.flatMap((chunk) => chunk.events);
    this.firstStep = this.chunks.at(0)?.firstStep ?? 0;
    this.lastStep = this.chunks.at(-1)?.lastStep ?? 0;
    this.dispatchEvent(new Event("change"));
  }

  get timeStep() {
    return this.header.time_step;
  }

  get firstTime() {
    return this.firstStep * this.timeStep;
  }

  get lastTime() {
    return this.lastStep * this.timeStep;
  }

  /** The step whose end is the newest at a time; rounding does not move a time one step back. */
  stepAt(time) {
    const step = Math.floor(time / this.timeStep + 1e-6);
    return Math.min(Math.max(step, this.firstStep), this.lastStep);
  }

  chunkAt(step) {
    let low = 0;
    let high = this.chunks.length - 1;
    while (low <= high) {
      const middle = (low + high) >> 1;
      const chunk = this.chunks[middle];
      if (step < chunk.firstStep) high = middle - 1;
      else if (step > chunk.lastStep) low = middle + 1;
      else return chunk;
    }
    return null;
  }

  /** The values of a vehicle at a step, by column; null where it is not on the road. */
  read(vehicle, step) {
    const chunk = this.chunkAt(step);
    const row = chunk ? chunk.find(vehicle, step) : -1;
    if (row < 0) return null;
    const values = {};
    for (const [name, column] of Object.entries(chunk.columns)) values[name] = column[row];
    return values;
  }

  /** A vehicle's first and last step, or null. */
  spanOf(vehicle) {
    let span = null;
    for (const chunk of this.chunks) {
      const segment = chunk.segments.get(vehicle);
      if (segment === undefined) continue;
      const first = chunk.columns.step[segment[0]];
      const last = chunk.columns.step[segment[1] - 1];
      span = span ? [span[0], last] : [first, last];
    }
    return span;
  }

  /** Calls visit(chunk, row) for each row of a vehicle within steps, in their order. */
  visit(vehicle, firstStep, lastStep, visit) {
    for (const chunk of this.chunks) {
      if (chunk.lastStep < firstStep || chunk.firstStep > lastStep) continue;
      const segment = chunk.segments.get(vehicle);
      if (segment === undefined) continue;
      for (let row = segment[0]; row < segment[1]; row += 1) {
        const step = chunk.columns.step[row];
        if (step >= firstStep && step <= lastStep) visit(chunk, row);
      }
    }
  }

  /** The names of a column's codes. */
  names(column) {
    return this.header.columns.find((one) => one.name === column).names;
  }
}
