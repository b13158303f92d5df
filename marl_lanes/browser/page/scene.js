// The vehicles at a time, between two steps where they are.

/** Places of all vehicles at one time, in arrays that are reused. */
export class Scene {
  constructor(store) {
    this.store = store;
    this.count = 0;
    this.chunk = null;
    this.step = 0;
    this.resize(64);
    this.index = new Map();
  }

  resize(size) {
    this.vehicle = new Int32Array(size);
    this.row = new Int32Array(size);
    this.position = new Float64Array(size);
    this.lateral = new Float64Array(size);
    this.yaw = new Float64Array(size);
  }

  /** Read a time. Values that are not interpolated are those of the step before: value(). */
  read(time) {
    const { store } = this;
    this.time = time;
    this.step = store.stepAt(time);
    this.chunk = store.chunkAt(this.step);
    this.index.clear();
    this.count = 0;
    if (!this.chunk) return;
    const rows = this.chunk.rowsAt(this.step);
    if (rows.length > this.vehicle.length) this.resize(2 * rows.length);
    this.count = rows.length;
    const share = Math.min(Math.max(time / store.timeStep - this.step, 0), 1);
    const isLast = this.step === this.chunk.lastStep;
    const after = isLast ? store.chunkAt(this.step + 1) : this.chunk;
    const { vehicle, position, lateral_position: lateral, yaw } = this.chunk.columns;
    for (let i = 0; i < rows.length; i += 1) {
      const row = rows[i];
      const id = vehicle[row];
      let next = -1;
      if (after === this.chunk) next = vehicle[row + 1] === id ? row + 1 : -1;
      else if (after) next = after.find(id, this.step + 1);
      this.vehicle[i] = id;
      this.row[i] = row;
      this.index.set(id, i);
      const s = next < 0 ? 0 : share;
      const to = next < 0 ? this.chunk.columns : after.columns;
      const at = next < 0 ? row : next;
      this.position[i] = position[row] + s * (to.position[at] - position[row]);
      this.lateral[i] = lateral[row] + s * (to.lateral_position[at] - lateral[row]);
      this.yaw[i] = yaw[row] + s * (to.yaw[at] - yaw[row]);
    }
  }

  /** A column's value of the i-th vehicle. */
  value(name, i) {
    return this.chunk.columns[name][this.row[i]];
  }

  /** The index of a vehicle's number, or -1. */
  find(vehicle) {
    return this.index.get(vehicle) ?? -1;
  }
}
