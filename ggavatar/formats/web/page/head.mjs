// The head model: vertices from a drive, in the order of ggavatar/head/model.py and head_pose.py.
import { compose, inverse, multiply, rotation } from "./algebra.mjs";

const NOTHING = 1e-7; // m: displacements below it are left out

// The numbers of a row that are not zero, with their places.
function sparse(row) {
  const places = [];
  for (let i = 0; i < row.length; i++) if (Math.abs(row[i]) > NOTHING) places.push(i);
  return { places: Uint32Array.from(places), values: Float32Array.from(places, (i) => row[i]) };
}

function sparseRows({ shape: [rows, width], data }) {
  return Array.from({ length: rows }, (_, row) => sparse(data.subarray(row * width, (row + 1) * width)));
}

function add(into, { places, values }, weight) {
  for (let i = 0; i < places.length; i++) into[places[i]] += weight * values[i];
}

export class Head {
  constructor(tensors, description) {
    const { head } = description;
    this.parents = head.parents;
    this.neck = Math.max(head.joint_names.indexOf("neck"), 0);
    this.root = head.joint_names.indexOf("root");
    this.followsFace = description.follows_face;
    this.holdsTorso = description.holds_torso;
    this.template = tensors.template.data;
    this.expression = sparseRows(tensors.expression_basis);
    this.correctives = sparseRows(tensors.pose_basis);
    this.lids = sparseRows(tensors.eyelid_basis);
    this.joints = tensors.joints.data;
    this.jointBasis = tensors.joint_basis.data;
    this.weights = tensors.skinning_weights.data;
    this.shaped = new Float32Array(this.template.length);
    this.posed = new Float32Array(this.template.length);
  }

  // Vertices of the posed head, m; the array is reused by the next call.
  vertices(drive) {
    if (this.followsFace) this.follow(drive);
    else this.posed.set(this.template);
    if (this.holdsTorso) this.holdTorso(drive);
    return this.posed;
  }

  follow(drive) {
    const rotations = this.parents.map((_, j) => rotation(...drive.joint_rotations.slice(3 * j, 3 * j + 3)));
    this.shape(drive, rotations);
    const { linear, affine } = this.jointTransforms(drive, rotations);
    this.skin(affine, drive.translation);
    this.closeLids(drive.eyelids, linear[this.neck]);
  }

  shape(drive, rotations) {
    this.shaped.set(this.template);
    this.expression.forEach((row, e) => drive.expression[e] && add(this.shaped, row, drive.expression[e]));
    this.correctives.forEach((row, p) => {
      const entry = rotations[1 + Math.floor(p / 9)][p % 9] - ((p % 9) % 4 === 0 ? 1 : 0);
      if (entry) add(this.shaped, row, entry);
    });
  }

  // World rotation of every joint, and its transform of a vertex that is bound to it alone (twelve numbers a joint).
  jointTransforms(drive, rotations) {
    const at = Float64Array.from(this.joints);
    const width = at.length;
    drive.expression.forEach((value, e) => {
      for (let i = 0; i < width; i++) at[i] += value * this.jointBasis[e * width + i];
    });
    const linear = [];
    const place = [];
    const affine = new Float32Array(12 * this.parents.length);
    this.parents.forEach((parent, j) => {
      const own = [at[3 * j], at[3 * j + 1], at[3 * j + 2]];
      if (parent < 0) {
        linear.push(rotations[j]);
        place.push(own);
      } else {
        const arm = [0, 1, 2].map((k) => own[k] - at[3 * parent + k]);
        linear.push(multiply(linear[parent], rotations[j]));
        place.push([0, 1, 2].map((k) => place[parent][k] + dot(linear[parent], k, arm)));
      }
      for (let k = 0; k < 3; k++) {
        affine.set(linear[j].slice(3 * k, 3 * k + 3), 12 * j + 4 * k);
        affine[12 * j + 4 * k + 3] = place[j][k] - dot(linear[j], k, own);
      }
    });
    return { linear, affine };
  }

  // Linear blend skinning; most vertices have one or two joints, so zero weights are skipped.
  skin(affine, translation) {
    const { shaped, posed, weights } = this;
    const joints = this.parents.length;
    const m = new Float32Array(12);
    for (let v = 0; 3 * v < shaped.length; v++) {
      m.fill(0);
      for (let j = 0; j < joints; j++) {
        const w = weights[v * joints + j];
        if (w > 0) for (let k = 0; k < 12; k++) m[k] += w * affine[12 * j + k];
      }
      const x = shaped[3 * v], y = shaped[3 * v + 1], z = shaped[3 * v + 2];
      posed[3 * v] = m[0] * x + m[1] * y + m[2] * z + m[3] + translation[0];
      posed[3 * v + 1] = m[4] * x + m[5] * y + m[6] * z + m[7] + translation[1];
      posed[3 * v + 2] = m[8] * x + m[9] * y + m[10] * z + m[11] + translation[2];
    }
  }

  // Displacements of the lids, added after skinning and turned with the neck.
  closeLids(closures, carrier) {
    this.lids.forEach(({ places, values }, side) => {
      const closure = closures[side];
      if (!closure) return;
      for (let i = 0; i < places.length; i++) {
        const axis = places[i] % 3;
        const first = places[i] - axis;
        for (let k = 0; k < 3; k++) this.posed[first + k] += closure * values[i] * carrier[3 * k + axis];
      }
    });
  }

  // Vertices of the torso keep the torso's pose: blended to it by their weight of the root.
  holdTorso(drive) {
    const t = compose(inverse(drive.head_to_camera), drive.torso_to_camera);
    const { posed, weights, root } = this;
    const joints = this.parents.length;
    for (let v = 0; 3 * v < posed.length; v++) {
      const w = weights[v * joints + root];
      if (!w) continue;
      const x = posed[3 * v], y = posed[3 * v + 1], z = posed[3 * v + 2];
      posed[3 * v] += w * (t[0] * x + t[1] * y + t[2] * z + t[3] - x);
      posed[3 * v + 1] += w * (t[4] * x + t[5] * y + t[6] * z + t[7] - y);
      posed[3 * v + 2] += w * (t[8] * x + t[9] * y + t[10] * z + t[11] - z);
    }
  }
}

function dot(matrix, row, vector) {
  return matrix[3 * row] * vector[0] + matrix[3 * row + 1] * vector[1] + matrix[3 * row + 2] * vector[2];
}
