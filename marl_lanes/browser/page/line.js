// The road in the plane: from places along it to x and y, and back.

export class Line {
  /** line: the header's points of the road's right edge. */
  constructor(line) {
    this.points = line;
  }

  /** The index of the point at or before a position. */
  search(position) {
    const points = this.points.position;
    let low = 0;
    let high = points.length - 2;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (points[middle] <= position) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Writes x, y [m] and the road's heading [rad] to out. */
  place(position, lateral, out) {
    const { position: at, x, y, heading } = this.points;
    const i = this.search(position);
    const share = Math.min(Math.max((position - at[i]) / (at[i + 1] - at[i]), 0), 1);
    const angle = heading[i] + share * (heading[i + 1] - heading[i]);
    out.x = x[i] + share * (x[i + 1] - x[i]) - Math.sin(angle) * lateral;
    out.y = y[i] + share * (y[i + 1] - y[i]) + Math.cos(angle) * lateral;
    out.heading = angle;
    return out;
  }

  /** Positions between which the road is drawn as straight, from first to last [m]. */
  breaks(first, last) {
    const at = this.points.position;
    const found = [first];
    for (let i = this.search(first) + 1; i < at.length && at[i] < last; i += 1) {
      if (at[i] > first) found.push(at[i]);
    }
    found.push(last);
    return found;
  }
}
