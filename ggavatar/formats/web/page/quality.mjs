// The size of the picture, px: full at rest, and smaller while it moves where the machine draws slowly.

const SLOW = 90; // ms a picture, above which a moving picture becomes smaller
const FAST = 25; // below which it becomes larger again
const SMALLEST = 0.25; // of the full side
const LARGEST_SIDE = 1024;
const ENLARGEMENT = 2; // of the trained size

export class Quality {
  constructor(camera) {
    this.camera = camera;
    this.share = 1;
  }

  // What a moving picture took, ms.
  note(milliseconds) {
    if (milliseconds > SLOW) this.share = Math.max(SMALLEST, this.share / 2);
    else if (milliseconds < FAST) this.share = Math.min(1, this.share * 2);
  }

  // Width and height for a picture that is shown with a width in px of the screen.
  size(shown, atRest) {
    const { width, height } = this.camera;
    const side = Math.max(width, height);
    const full = Math.min((shown * side) / width, ENLARGEMENT * side, LARGEST_SIDE);
    const scale = (full * (atRest ? 1 : this.share)) / side;
    return [Math.max(16, Math.round(width * scale)), Math.max(16, Math.round(height * scale))];
  }
}
