// The avatar: poses its Gaussians for a drive and sorts them for a view.
import { Adjuster } from "./adjuster.mjs";
import { DepthSort } from "./depth_sort.mjs";
import { Head } from "./head.mjs";
import { Placement } from "./placement.mjs";
import { FRAME, triangleFrames } from "./triangles.mjs";

export class Avatar {
  constructor({ description, tensors }) {
    this.head = new Head(tensors, description);
    this.faces = tensors.faces.data;
    this.frames = new Float32Array((this.faces.length / 3) * FRAME);
    this.adjuster = description.adjuster ? new Adjuster(tensors, description) : null;
    this.placement = new Placement(tensors, description);
    this.sort = new DepthSort(description.gaussians);
  }

  get stride() {
    return this.placement.stride;
  }

  // The numbers of all Gaussians (see placement.mjs); the array is reused by the next call.
  pose(drive) {
    triangleFrames(this.head.vertices(drive), this.faces, this.frames);
    return this.placement.run(this.frames, this.adjuster ? this.adjuster.run(drive) : null);
  }

  order(view) {
    return this.sort.run(this.placement.placed, this.stride, view);
  }
}

// What does not change with the drive: one texel a coefficient of the harmonics, and the opacity beside the first.
export function appearance({ description, tensors }) {
  const coefficients = (description.sh_degree + 1) ** 2;
  const texels = new Float32Array(4 * coefficients * description.gaussians);
  const { data } = tensors.harmonics;
  for (let i = 0; i * 3 < data.length; i++) texels.set(data.subarray(3 * i, 3 * i + 3), 4 * i);
  tensors.opacity_logits.data.forEach((logit, i) => {
    texels[4 * coefficients * i + 3] = 1 / (1 + Math.exp(-logit));
  });
  return texels;
}

// The clips with their arrays, by the names of the file.
export function clipsOf({ description, tensors }) {
  return description.clips.map((clip, index) => {
    const prefix = `clip.${index}.`;
    const own = Object.keys(tensors).filter((name) => name.startsWith(prefix));
    return { ...clip, arrays: Object.fromEntries(own.map((name) => [name.slice(prefix.length), tensors[name]])) };
  });
}
