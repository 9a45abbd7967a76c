// The Geometry Morph Adjuster (GGAvatar Eq. 9-11): rows W f of every Gaussian, with W = A h + c contracted with f first.
import { rotation } from "./algebra.mjs";
import { RIGID } from "./container.mjs";

const LEAST_HALF_RANGE = 1e-4; // of a feature of the head pose, as ggavatar/head/head_pose.py
const BLOCK = 8; // columns of the hidden layer that the product takes at a time; the rest of the last block is zero

export class Adjuster {
  constructor(tensors, description) {
    const { rows, latent, layers, sees_pose: seesPose } = description.adjuster;
    Object.assign(this, { rows, latent, seesPose });
    this.joints = description.head.joint_names.map((name, j) => (RIGID.has(name) ? -1 : j)).filter((j) => j >= 0);
    this.pose = ["reference", "least", "most"].map((name) => tensors[`pose.${name}`].data);
    this.layers = Array.from({ length: layers }, (_, i) => ({
      weight: tensors[`adjuster.latent.${i}.weight`].data,
      bias: tensors[`adjuster.latent.${i}.bias`].data,
    }));
    this.rank = description.adjuster.rank;
    this.width = BLOCK * Math.ceil(this.rank / BLOCK);
    this.weight = tensors["adjuster.last_weight"].data;
    this.bias = tensors["adjuster.last_bias"].data;
    this.hidden = padded(tensors["adjuster.hidden"].data, this.rank, this.width);
    this.matrix = new Float64Array(rows * this.width); // block by block: BLOCK columns of every row, then the next ones
    this.constant = new Float64Array(rows);
    this.offsets = new Float32Array((this.hidden.length / this.width) * rows);
  }

  // Expression, all joints but root and neck as 6D rotations, lids, and the head pose if it is part of the condition.
  condition(drive) {
    const values = [...drive.expression];
    for (const j of this.joints) {
      values.push(...rotation(...drive.joint_rotations.slice(3 * j, 3 * j + 3)).slice(0, 6));
    }
    values.push(...drive.eyelids);
    if (this.seesPose) values.push(...this.poseFeatures(drive.head_to_camera));
    return values;
  }

  // Rotation from the mean pose (6D) and translation from it, scaled to [-1, 1] by their range in training and clamped.
  poseFeatures(pose) {
    const [reference, low, high] = this.pose;
    const raw = [];
    for (let i = 0; i < 2; i++) {
      for (let j = 0; j < 3; j++) {
        raw.push([0, 1, 2].reduce((sum, k) => sum + pose[4 * i + k] * reference[4 * j + k], 0));
      }
    }
    for (let i = 0; i < 3; i++) raw.push(pose[4 * i + 3] - reference[4 * i + 3]);
    return raw.map((value, i) => {
      const half = Math.max((high[i] - low[i]) / 2, LEAST_HALF_RANGE);
      return Math.min(1, Math.max(-1, (value - (high[i] + low[i]) / 2) / half));
    });
  }

  latentVector(condition) {
    return this.layers.reduce((input, { weight, bias }, index) => {
      const isLast = index + 1 === this.layers.length;
      return Float32Array.from(bias, (sum, row) => {
        for (let k = 0; k < input.length; k++) sum += weight[row * input.length + k] * input[k];
        return isLast ? sum : Math.max(sum, 0);
      });
    }, Float32Array.from(condition));
  }

  // The rows of every Gaussian for a drive; the array is reused by the next call.
  run(drive) {
    this.contract(this.latentVector(this.condition(drive)));
    return this.product();
  }

  contract(f) {
    const { matrix, constant, weight, bias, rank, latent } = this;
    matrix.fill(0);
    constant.fill(0);
    for (let r = 0; r < this.rows; r++) {
      for (let l = 0; l < latent; l++) {
        constant[r] += f[l] * bias[r * latent + l];
        for (let k = 0; k < rank; k++) {
          const block = Math.floor(k / BLOCK);
          matrix[(block * this.rows + r) * BLOCK + (k % BLOCK)] += f[l] * weight[(r * latent + l) * rank + k];
        }
      }
    }
  }

  // Half of the time of a frame is here. Eight columns at a time stay in registers while all rows use them, and their
  // sums are added in pairs, since a single sum would wait for its own last addition: twice as fast as the plain loop.
  product() {
    const { hidden, matrix, constant, offsets, rows, width } = this;
    for (let h = 0, o = 0; h < hidden.length; h += width, o += rows) {
      for (let r = 0; r < rows; r++) offsets[o + r] = constant[r];
      for (let k = h, m = 0; k < h + width; k += BLOCK) {
        const h0 = hidden[k], h1 = hidden[k + 1], h2 = hidden[k + 2], h3 = hidden[k + 3];
        const h4 = hidden[k + 4], h5 = hidden[k + 5], h6 = hidden[k + 6], h7 = hidden[k + 7];
        for (let r = o; r < o + rows; r++, m += BLOCK) {
          const first = h0 * matrix[m] + h1 * matrix[m + 1] + (h2 * matrix[m + 2] + h3 * matrix[m + 3]);
          const second = h4 * matrix[m + 4] + h5 * matrix[m + 5] + (h6 * matrix[m + 6] + h7 * matrix[m + 7]);
          offsets[r] += first + second;
        }
      }
    }
    return offsets;
  }
}

// The columns of a matrix in rows of `width`, the rest zero.
function padded(data, columns, width) {
  const rows = data.length / columns;
  const out = new Float32Array(rows * width);
  for (let row = 0; row < rows; row++) out.set(data.subarray(row * columns, (row + 1) * columns), row * width);
  return out;
}
