// Local frames of triangles (GGAvatar Eq. 4-5), as ggavatar/geometry/triangles.py: center, rotation, size, quaternion.

export const FRAME = 17; // numbers a triangle: center 3, rotation 9 (row by row), size 1, quaternion wxyz 4
const LEAST_LENGTH = 1e-20;

export function triangleFrames(vertices, faces, frames) {
  const axes = new Float64Array(9); // three columns, one after the other
  for (let f = 0, o = 0; f < faces.length; f += 3, o += FRAME) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = vertices[b] - vertices[a], uy = vertices[b + 1] - vertices[a + 1], uz = vertices[b + 2] - vertices[a + 2];
    const vx = vertices[c] - vertices[a], vy = vertices[c + 1] - vertices[a + 1], vz = vertices[c + 2] - vertices[a + 2];
    const length = Math.sqrt(ux * ux + uy * uy + uz * uz);
    fillAxes(axes, ux, uy, uz, vx, vy, vz, length);
    frames[o] = vertices[a] + (ux + vx) / 3;
    frames[o + 1] = vertices[a + 1] + (uy + vy) / 3;
    frames[o + 2] = vertices[a + 2] + (uz + vz) / 3;
    for (let k = 0; k < 3; k++) {
      frames[o + 3 + 3 * k] = axes[k];
      frames[o + 4 + 3 * k] = axes[3 + k];
      frames[o + 5 + 3 * k] = axes[6 + k];
    }
    frames[o + 12] = (length + Math.abs(axes[6] * vx + axes[7] * vy + axes[8] * vz)) / 2;
    fillQuaternion(frames, o);
  }
}

// Along the first edge, along the normal, and across both; triangles without area get some valid axes.
function fillAxes(axes, ux, uy, uz, vx, vy, vz, length) {
  let x0 = 1, x1 = 0, x2 = 0;
  if (length > LEAST_LENGTH) (x0 = ux / length), (x1 = uy / length), (x2 = uz / length);
  let y0 = x1 * vz - x2 * vy, y1 = x2 * vx - x0 * vz, y2 = x0 * vy - x1 * vx;
  if (!(y0 * y0 + y1 * y1 + y2 * y2 > LEAST_LENGTH * LEAST_LENGTH)) {
    const w0 = x2 + 0.3, w1 = x0 - 0.2, w2 = x1 + 0.1;
    (y0 = x1 * w2 - x2 * w1), (y1 = x2 * w0 - x0 * w2), (y2 = x0 * w1 - x1 * w0);
  }
  const n = 1 / Math.sqrt(y0 * y0 + y1 * y1 + y2 * y2);
  (y0 *= n), (y1 *= n), (y2 *= n);
  (axes[0] = x0), (axes[1] = x1), (axes[2] = x2);
  (axes[3] = y0), (axes[4] = y1), (axes[5] = y2);
  (axes[6] = x1 * y2 - x2 * y1), (axes[7] = x2 * y0 - x0 * y2), (axes[8] = x0 * y1 - x1 * y0);
}

// The quaternion of the rotation at frames[o + 3 …], from its largest component.
function fillQuaternion(frames, o) {
  const r00 = frames[o + 3], r01 = frames[o + 4], r02 = frames[o + 5];
  const r10 = frames[o + 6], r11 = frames[o + 7], r12 = frames[o + 8];
  const r20 = frames[o + 9], r21 = frames[o + 10], r22 = frames[o + 11];
  const a = 1 + r00 + r11 + r22, b = 1 + r00 - r11 - r22, c = 1 - r00 + r11 - r22, d = 1 - r00 - r11 + r22;
  let w, x, y, z;
  if (a >= b && a >= c && a >= d) (w = a), (x = r21 - r12), (y = r02 - r20), (z = r10 - r01);
  else if (b >= c && b >= d) (w = r21 - r12), (x = b), (y = r10 + r01), (z = r02 + r20);
  else if (c >= d) (w = r02 - r20), (x = r10 + r01), (y = c), (z = r21 + r12);
  else (w = r10 - r01), (x = r02 + r20), (y = r21 + r12), (z = d);
  const n = 1 / Math.sqrt(w * w + x * x + y * y + z * z);
  (frames[o + 13] = w * n), (frames[o + 14] = x * n), (frames[o + 15] = y * n), (frames[o + 16] = z * n);
}
