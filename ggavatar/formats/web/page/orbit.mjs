// The point of view: the camera turns about the center of the head, which keeps its place in the picture.
import { applied, compose, multiply, rigid, rotation, turnAbout } from "./algebra.mjs";

const NEAREST = 0.35; // of the distance in the clip
const FARTHEST = 3;
const STEEPEST = 1.4; // rad

export class Orbit {
  constructor(range, center) {
    Object.assign(this, { range, center, free: false });
    this.reset();
  }

  reset() {
    Object.assign(this, { yaw: 0, pitch: 0, distance: 1 });
  }

  // Turn by angles, rad; within what training saw unless the view is free.
  turn(yaw, pitch) {
    const { range } = this;
    const sides = this.free ? [-Infinity, Infinity] : range.yaw;
    const heights = this.free ? [-STEEPEST, STEEPEST] : range.pitch;
    this.yaw = clamp(this.yaw + yaw, sides);
    this.pitch = clamp(this.pitch + pitch, heights);
  }

  zoom(factor) {
    this.distance = clamp(this.distance * factor, [NEAREST, FARTHEST]);
  }

  setFree(free) {
    this.free = free;
    this.turn(0, 0);
  }

  // World to camera, twelve numbers, given that of the drive and the head's pose.
  view(drive) {
    if (!this.yaw && !this.pitch && this.distance === 1) return drive.world_to_camera;
    const pivot = applied(drive.head_to_camera, this.center);
    const turn = multiply(rotation(this.pitch, 0, 0), rotation(0, this.yaw, 0));
    const nearer = pivot.map((value) => value * (this.distance - 1));
    return compose(rigid([1, 0, 0, 0, 1, 0, 0, 0, 1], ...nearer), compose(turnAbout(turn, pivot), drive.world_to_camera));
  }
}

function clamp(value, [low, high]) {
  return Math.min(Math.max(value, low), high);
}
