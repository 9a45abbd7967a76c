// Drives: everything that animates the head at one moment, with the names and units of ggavatar.core.Drive and the camera.
import { axisAngle, compose, mixed, multiply, rotation, straightened, transposed, turnAbout } from "./algebra.mjs";

const ANGLE_PARTS = ["expression", "joint_rotations", "eyelids", "translation", "intrinsics"];
const POSE_PARTS = ["head_to_camera", "torso_to_camera", "world_to_camera"];

// No expression and all joints at rest, seen from where training saw the head.
export function restDrive({ head, rest, camera }) {
  return {
    expression: new Array(head.expressions).fill(0),
    joint_rotations: new Array(3 * head.joint_names.length).fill(0),
    eyelids: [0, 0],
    translation: [0, 0, 0],
    intrinsics: camera.intrinsics,
    head_to_camera: rest.view,
    torso_to_camera: rest.view,
    world_to_camera: rest.view,
  };
}

// The drive of a clip between two of its frames; beyond the ends, that of the first or last.
export function clipDrive({ frames, arrays }, position) {
  const last = frames.length - 1;
  const at = Math.min(Math.max(position, 0), last);
  const before = Math.floor(at);
  const after = Math.min(before + 1, last);
  const share = at - before;
  const read = (name) => {
    const { data, shape } = arrays[name];
    const rows = [before, after].map((row) => data.subarray(row * shape[1], (row + 1) * shape[1]));
    return share ? mixed(rows[0], rows[1], share) : Array.from(rows[0]);
  };
  const drive = {};
  for (const name of ANGLE_PARTS) drive[name] = read(name);
  for (const name of POSE_PARTS) drive[name] = share ? straightened(read(name)) : read(name);
  return drive;
}

// Inside the training range unchanged; beyond it saturating smoothly, as ggavatar-render --limit does.
export function softClip(value, low, high, zone) {
  const inside = Math.min(Math.max(value, low), high);
  return zone > 0 ? inside + zone * Math.tanh((value - inside) / zone) : inside;
}

// What ARKit's scores, by name, make of a resting drive; names that the head does not know change nothing.
export function arkitDrive(description, scores) {
  const drive = restDrive(description);
  const { arkit, limits } = description.controls;
  for (const [name, score] of Object.entries(scores)) {
    const amount = Math.min(1, Math.max(0, score));
    for (const [part, index, factor] of arkit[name] || []) drive[part][index] += factor * amount;
  }
  for (const [part, [low, high, zone]] of Object.entries(limits)) {
    drive[part] = drive[part].map((value, index) => softClip(value, low[index], high[index], zone[index]));
  }
  return drive;
}

// The head turned about its neck by yaw, pitch and roll, rad; a torso that has a pose or a joint of its own stays.
export function turnedHead(drive, { yaw, pitch, roll }, description, neck) {
  if (!yaw && !pitch && !roll) return drive;
  const turn = multiply(rotation(0, yaw, 0), multiply(rotation(pitch, 0, 0), rotation(0, 0, roll)));
  const about = turnAbout(turn, neck);
  const turned = { ...drive, head_to_camera: compose(drive.head_to_camera, about) };
  if (!description.moves_camera) return withJoint(turned, description, "neck", (own) => multiply(own, turn));
  turned.world_to_camera = compose(drive.world_to_camera, about);
  return withJoint(turned, description, "cervical", (own) => multiply(transposed(turn), own));
}

// The drive with the rotation of one joint changed; the same drive if the head has no such joint.
function withJoint(drive, { head }, name, change) {
  const joint = head.joint_names.indexOf(name);
  if (joint < 0) return drive;
  const angles = [...drive.joint_rotations];
  const own = rotation(...angles.slice(3 * joint, 3 * joint + 3));
  angles.splice(3 * joint, 3, ...axisAngle(change(own)));
  return { ...drive, joint_rotations: angles };
}
