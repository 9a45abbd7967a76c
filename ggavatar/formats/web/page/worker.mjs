// The worker's side: it opens the file once, then poses and sorts what the page asks for.
import { appearance, Avatar, clipsOf } from "./avatar.mjs";
import { Damaged, unpack } from "./container.mjs";

let avatar = null;

function open(buffer) {
  const file = unpack(buffer);
  avatar = new Avatar(file);
  const texels = appearance(file);
  const joints = file.tensors.joints.data;
  const { description } = file;
  postMessage({ description, joints, clips: clipsOf(file), stride: avatar.stride, texels }, [texels.buffer]);
}

// A drive of null keeps the pose of the last request: only the order is new.
function answer({ drive, view }) {
  const started = performance.now();
  const placed = drive ? avatar.pose(drive).slice() : null;
  const order = avatar.order(view);
  const milliseconds = performance.now() - started;
  postMessage({ placed, order, milliseconds }, placed ? [placed.buffer, order.buffer] : [order.buffer]);
}

onmessage = ({ data }) => {
  try {
    if (data.buffer) open(data.buffer);
    else answer(data);
  } catch (error) {
    postMessage({ error: error instanceof Damaged ? error.message : `This avatar cannot be shown (${error.message}).` });
  }
};
