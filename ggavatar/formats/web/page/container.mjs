// The file inside of the page: safetensors with a description (docs/web-avatar.md). Everything is checked before use,
// since a page may be damaged on its way.

const SCHEMA = "ggavatar-web";
const VERSION = 1;
const ARRAYS = { U8: Uint8Array, U16: Uint16Array, U32: Uint32Array, F32: Float32Array };
const MAX_BYTES = 64 * 1024 * 1024;
const MAX_GAUSSIANS = 500000;
const ZERO_WITHIN = 1e-2; // steps: `low` is rounded to float32, so an exact zero may come out as the rest of a rounding

const INDICES = new Set(["faces", "face"]);

export const RIGID = new Set(["root", "neck"]); // joints that are not part of the adjuster's condition

export class Damaged extends Error {}

function damaged(what) {
  return new Damaged(`The avatar in this page is damaged (${what}). Save the page again.`);
}

function demand(condition, what) {
  if (!condition) throw damaged(what);
}

// Description and tensors of a file; a tensor is {shape, data}, and quantized ones are numbers again.
export function unpack(buffer) {
  try {
    return opened(buffer);
  } catch (error) {
    if (error instanceof Damaged) throw error;
    throw damaged("description"); // a part of it is missing or of another kind, so that reading it has failed
  }
}

function opened(buffer) {
  demand(buffer.byteLength > 8 && buffer.byteLength <= MAX_BYTES + 1048576, "size");
  const size = Number(new DataView(buffer).getBigUint64(0, true));
  demand(size > 2 && 8 + size <= buffer.byteLength, "header");
  const header = parsed(new TextDecoder().decode(new Uint8Array(buffer, 8, size)));
  const description = parsed(header.__metadata__?.avatar);
  demand(description.schema === SCHEMA, "kind of file");
  if (description.version !== VERSION) {
    throw new Damaged(`This avatar has version ${description.version}; this page reads version ${VERSION}.`);
  }
  delete header.__metadata__;
  const stored = {};
  for (const [name, entry] of Object.entries(header)) stored[name] = tensorOf(buffer, 8 + size, name, entry);
  const tensors = dequantized(stored);
  checkShapes(tensors, description);
  return { description, tensors };
}

function parsed(text) {
  const value = JSON.parse(text);
  demand(value !== null && typeof value === "object", "header");
  return value;
}

function tensorOf(buffer, start, name, { dtype, shape, data_offsets: offsets }) {
  const Kind = ARRAYS[dtype];
  demand(Kind && Array.isArray(shape) && Array.isArray(offsets), name);
  demand(shape.every((length) => Number.isInteger(length) && length >= 0), name);
  const [from, to] = offsets;
  demand(Number.isInteger(from) && Number.isInteger(to) && from >= 0 && from <= to, name);
  demand(start + to <= buffer.byteLength, name);
  const length = shape.reduce((product, side) => product * side, 1);
  demand(length * Kind.BYTES_PER_ELEMENT === to - from, name);
  return { shape, data: new Kind(buffer.slice(start + from, start + to)) }; // a copy, since offsets need not be aligned
}

function dequantized(stored) {
  const tensors = {};
  for (const [name, { shape, data }] of Object.entries(stored)) {
    if (name.endsWith(".low") || name.endsWith(".step")) continue;
    const low = stored[`${name}.low`];
    const step = stored[`${name}.step`];
    demand(Boolean(low) === Boolean(step), name);
    tensors[name] = low ? { shape, data: numbers(name, shape, data, low, step) } : { shape, data };
  }
  return tensors;
}

// x = low + step q, with one scale a column (scales of shape [1, C]) or a row ([R, 1]).
export function numbers(name, shape, values, low, step) {
  const [rows, columns] = shape;
  const byColumn = low.shape[0] === 1 && low.shape[1] === columns;
  demand(shape.length === 2 && String(low.shape) === String(step.shape), name);
  demand(byColumn || (low.shape[0] === rows && low.shape[1] === 1), name);
  const out = new Float32Array(values.length);
  for (let row = 0, i = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++, i++) {
      const scale = byColumn ? column : row;
      const value = low.data[scale] + step.data[scale] * values[i];
      out[i] = Math.abs(value) < ZERO_WITHIN * step.data[scale] ? 0 : value;
    }
  }
  return out;
}

// Every layer takes what the one before gives: first the condition, at last the latent vector.
function checkLayers(tensors, { layers, latent }, inputs) {
  demand(Number.isInteger(layers) && layers > 0 && layers < 100, "layers");
  let width = inputs;
  for (let index = 0; index < layers; index++) {
    const [weight, bias] = ["weight", "bias"].map((name) => tensors[`adjuster.latent.${index}.${name}`]);
    demand(weight && bias && weight.shape[1] === width && weight.shape[0] === bias.data.length, `layer ${index}`);
    width = bias.data.length;
  }
  demand(width === latent, "latent vector");
}

function checkShapes(tensors, { head, gaussians, sh_degree: degree, adjuster, clips }) {
  demand(Number.isInteger(gaussians) && gaussians > 0 && gaussians <= MAX_GAUSSIANS, "number of Gaussians");
  const { vertices: V, triangles: F, expressions: E, pose_correctives: P, joint_names: joints } = head;
  const J = joints.length;
  const expected = {
    template: [V, 3], faces: [F, 3], expression_basis: [E, 3 * V], pose_basis: [P, 3 * V], eyelid_basis: [2, 3 * V],
    joints: [J, 3], joint_basis: [E, 3 * J], skinning_weights: [V, J],
    face: [gaussians], means: [gaussians, 3], quats: [gaussians, 4], log_scales: [gaussians, 3],
    opacity_logits: [gaussians, 1], harmonics: [gaussians, 3 * (degree + 1) ** 2],
    "pose.reference": [1, 12], "pose.least": [1, 9], "pose.most": [1, 9],
  };
  if (adjuster) {
    expected["adjuster.hidden"] = [gaussians, adjuster.rank];
    expected["adjuster.last_weight"] = [adjuster.rows * adjuster.latent, adjuster.rank];
    expected["adjuster.last_bias"] = [adjuster.rows, adjuster.latent];
    checkLayers(tensors, adjuster, E + 6 * joints.filter((name) => !RIGID.has(name)).length + 2 + 9 * adjuster.sees_pose);
  }
  clips.forEach(({ frames }, index) => {
    const widths = { expression: E, joint_rotations: 3 * J, eyelids: 2, translation: 3, head_to_camera: 12 };
    Object.assign(widths, { torso_to_camera: 12, world_to_camera: 12, intrinsics: 4 });
    for (const [name, width] of Object.entries(widths)) expected[`clip.${index}.${name}`] = [frames.length, width];
  });
  for (const [name, shape] of Object.entries(expected)) {
    demand(tensors[name] && String(tensors[name].shape) === String(shape), name);
    demand(INDICES.has(name) !== tensors[name].data instanceof Float32Array, name);
  }
  demand(tensors.faces.data.every((vertex) => vertex < V), "faces");
  demand(tensors.face.data.every((face) => face < F), "face");
}
