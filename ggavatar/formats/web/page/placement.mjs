// From triangles to the world (GGAvatar Eq. 6-8), refined by the adjuster's rows (Eq. 12; docs/paper.md, A4 and A5).
import { FRAME } from "./triangles.mjs";

const SH_C0 = 0.28209479177387814;
const GEOMETRY_ROWS = 10; // position 3, rotation 4, log-scale 3; color rows follow

// Numbers a Gaussian: mean 3, scale 3, free 2, quaternion wxyz 4, and with color rows the change of color 3, free 1.
export function stride(rows) {
  return rows > GEOMETRY_ROWS ? 16 : 12;
}

export class Placement {
  constructor(tensors, description) {
    const { adjuster } = description;
    this.rows = adjuster ? adjuster.rows : 0;
    this.unit = adjuster ? adjuster.unit : 0;
    this.colorUnit = adjuster ? adjuster.color_unit / SH_C0 : 0;
    this.face = tensors.face.data;
    this.means = tensors.means.data;
    this.quats = normalized(tensors.quats.data);
    this.scales = tensors.log_scales.data.map(Math.exp);
    this.stride = stride(this.rows);
    this.placed = new Float32Array(this.face.length * this.stride);
  }

  run(frames, offsets) {
    const { face, means, quats, scales, placed } = this;
    for (let i = 0, g = 0; i < face.length; i++, g += this.stride) {
      const f = FRAME * face[i];
      const size = frames[f + 12];
      const x = means[3 * i], y = means[3 * i + 1], z = means[3 * i + 2];
      for (let k = 0; k < 3; k++) {
        const r = f + 3 + 3 * k;
        placed[g + k] = frames[f + k] + size * (frames[r] * x + frames[r + 1] * y + frames[r + 2] * z);
        placed[g + 3 + k] = size * scales[3 * i + k];
      }
      product(frames, f + 13, quats, 4 * i, placed, g + 8);
    }
    if (offsets) this.refine(offsets);
    return placed;
  }

  refine(offsets) {
    const { placed, rows, unit, colorUnit } = this;
    const turn = new Float64Array(4);
    const before = new Float64Array(4);
    for (let o = 0, g = 0; o < offsets.length; o += rows, g += this.stride) {
      for (let k = 0; k < 3; k++) {
        placed[g + k] += unit * offsets[o + k];
        placed[g + 3 + k] *= Math.exp(offsets[o + 7 + k]);
      }
      const w = 1 + offsets[o + 3], x = offsets[o + 4], y = offsets[o + 5], z = offsets[o + 6];
      const n = 1 / Math.sqrt(w * w + x * x + y * y + z * z);
      (turn[0] = w * n), (turn[1] = x * n), (turn[2] = y * n), (turn[3] = z * n);
      for (let k = 0; k < 4; k++) before[k] = placed[g + 8 + k];
      product(turn, 0, before, 0, placed, g + 8);
      for (let k = GEOMETRY_ROWS; k < rows; k++) placed[g + 2 + k] = colorUnit * offsets[o + k];
    }
  }
}

// Hamilton product of the quaternions wxyz at a[i …] and b[j …], written to out[o …].
function product(a, i, b, j, out, o) {
  const aw = a[i], ax = a[i + 1], ay = a[i + 2], az = a[i + 3];
  const bw = b[j], bx = b[j + 1], by = b[j + 2], bz = b[j + 3];
  out[o] = aw * bw - ax * bx - ay * by - az * bz;
  out[o + 1] = aw * bx + ax * bw + ay * bz - az * by;
  out[o + 2] = aw * by - ax * bz + ay * bw + az * bx;
  out[o + 3] = aw * bz + ax * by - ay * bx + az * bw;
}

function normalized(quats) {
  const out = Float32Array.from(quats);
  for (let q = 0; q < out.length; q += 4) {
    const n = 1 / Math.hypot(out[q], out[q + 1], out[q + 2], out[q + 3]);
    for (let k = 0; k < 4; k++) out[q + k] *= n;
  }
  return out;
}
