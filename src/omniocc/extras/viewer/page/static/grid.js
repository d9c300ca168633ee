// Cells of a grid as in omniocc.geometry: a cylinder (r, theta, z) or a cuboid (x, y, z), ego frame, metres.

export class Grid {
  // `facts`: kind, shape and bounds of the three axes, as `omniocc.extras.viewer.page.pack` writes them.
  constructor(facts) {
    Object.assign(this, facts);
    this.cylinder = facts.kind === "cylinder";
    this.cells = this.shape[0] * this.shape[1] * this.shape[2];
    this.strides = [this.shape[1] * this.shape[2], this.shape[2], 1];
    this.size = this.bounds.map(([low, high], axis) => (high - low) / this.shape[axis]);
    this.edges = this.bounds.map(([low], axis) => Float64Array.from({ length: this.shape[axis] + 1 }, (_, k) => low + k * this.size[axis]));
    if (this.cylinder) {
      this.cos = this.edges[1].map(Math.cos);
      this.sin = this.edges[1].map(Math.sin);
      // the last boundary is the first one
      this.cos[this.shape[1]] = this.cos[0];
      this.sin[this.shape[1]] = this.sin[0];
    }
  }

  // The point where the boundaries i, j, k of the three axes meet.
  corner(i, j, k) {
    const first = this.edges[0][i], height = this.edges[2][k];
    return this.cylinder ? [first * this.cos[j], first * this.sin[j], height] : [first, this.edges[1][j], height];
  }

  // The centre of a cell, by its flat index.
  center(cell) {
    const [first, second, height] = this.indices(cell).map((index, axis) => this.edges[axis][index] + this.size[axis] / 2);
    return this.cylinder ? [first * Math.cos(second), first * Math.sin(second), height] : [first, second, height];
  }

  // The indices of a flat cell index along the three axes.
  indices(cell) {
    return [Math.floor(cell / this.strides[0]), Math.floor(cell / this.strides[1]) % this.shape[1], cell % this.shape[2]];
  }
}
