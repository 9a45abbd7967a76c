// The order in which Gaussians are drawn: by camera z, near to far; a counting sort in as many steps as 16 bits have.

const STEPS = 65536;

export class DepthSort {
  constructor(count) {
    this.depths = new Float32Array(count);
    this.keys = new Uint16Array(count);
    this.starts = new Uint32Array(STEPS + 1);
  }

  // Indices of the Gaussians in `placed` (`stride` numbers each), for a view of twelve numbers; stable.
  run(placed, stride, view) {
    const { depths, keys, starts } = this;
    const count = depths.length;
    const a = view[8], b = view[9], c = view[10], d = view[11];
    let low = Infinity, high = -Infinity;
    for (let i = 0, g = 0; i < count; i++, g += stride) {
      const depth = a * placed[g] + b * placed[g + 1] + c * placed[g + 2] + d;
      depths[i] = depth;
      if (depth < low) low = depth;
      if (depth > high) high = depth;
    }
    const scale = (STEPS - 1) / Math.max(high - low, 1e-9);
    starts.fill(0);
    for (let i = 0; i < count; i++) {
      const key = ((depths[i] - low) * scale) | 0;
      keys[i] = key;
      starts[key + 1]++;
    }
    for (let key = 0; key < STEPS; key++) starts[key + 1] += starts[key];
    const order = new Uint32Array(count);
    for (let i = 0; i < count; i++) order[starts[keys[i]]++] = i;
    return order;
  }
}
