// Rotations as nine numbers and rigid transforms as the twelve of their upper three rows, both row by row; angles in rad.

const SMALL_ANGLE = 1e-4;

// Rotation by an axis-angle vector (Rodrigues), by its series near zero.
export function rotation(x, y, z) {
  const angle = Math.hypot(x, y, z);
  const small = angle < SMALL_ANGLE;
  const s = small ? 1 - (angle * angle) / 6 : Math.sin(angle) / angle;
  const c = small ? 0.5 - (angle * angle) / 24 : (1 - Math.cos(angle)) / (angle * angle);
  return [
    1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y,
    c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x,
    c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y),
  ];
}

export function multiply(a, b) {
  const out = new Array(9);
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) {
      out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
    }
  }
  return out;
}

export function transposed(r) {
  return [r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]];
}

// Axis-angle vector of a rotation; the axis of a half turn is found by its largest component.
export function axisAngle(r) {
  const [x, y, z] = [r[7] - r[5], r[2] - r[6], r[3] - r[1]];
  const sine = Math.hypot(x, y, z) / 2;
  const cosine = (r[0] + r[4] + r[8] - 1) / 2;
  const angle = Math.atan2(sine, cosine);
  if (sine > 1e-7) return [x, y, z].map((value) => (value * angle) / (2 * sine));
  if (cosine > 0) return [x / 2, y / 2, z / 2];
  const largest = [0, 4, 8].reduce((best, k) => (r[k] > r[best] ? k : best)) / 4;
  const column = [0, 1, 2].map((k) => r[3 * k + largest] + (k === largest ? 1 : 0));
  const length = Math.hypot(...column);
  return column.map((value) => (value * angle) / length);
}

export function rigid(r, x, y, z) {
  return [r[0], r[1], r[2], x, r[3], r[4], r[5], y, r[6], r[7], r[8], z];
}

export function rotationOf(m) {
  return [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]];
}

export function applied(m, point) {
  return [0, 4, 8].map((k) => m[k] * point[0] + m[k + 1] * point[1] + m[k + 2] * point[2] + m[k + 3]);
}

// The transform that applies b, then a.
export function compose(a, b) {
  const shift = applied(a, [b[3], b[7], b[11]]);
  return rigid(multiply(rotationOf(a), rotationOf(b)), ...shift);
}

export function inverse(m) {
  const r = transposed(rotationOf(m));
  const shift = applied(rigid(r, 0, 0, 0), [m[3], m[7], m[11]]);
  return rigid(r, -shift[0], -shift[1], -shift[2]);
}

// The turn by a rotation about a point that stays where it is.
export function turnAbout(r, point) {
  const moved = applied(rigid(r, 0, 0, 0), point);
  return rigid(r, point[0] - moved[0], point[1] - moved[1], point[2] - moved[2]);
}

export function mixed(a, b, share) {
  return Array.from(a, (value, index) => value + share * (b[index] - value));
}

// A transform whose rotation has lost its length, as a mixture of two has, made rigid again (Gram-Schmidt on its rows).
export function straightened(m) {
  const n = 1 / Math.hypot(m[0], m[1], m[2]);
  const x = [m[0] * n, m[1] * n, m[2] * n];
  const along = x[0] * m[4] + x[1] * m[5] + x[2] * m[6];
  const rest = [m[4] - along * x[0], m[5] - along * x[1], m[6] - along * x[2]];
  const k = 1 / Math.hypot(...rest);
  const y = rest.map((value) => value * k);
  const z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
  return rigid([...x, ...y, ...z], m[3], m[7], m[11]);
}
