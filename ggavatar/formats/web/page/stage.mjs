// What is shown: a drive, the head's turn and the point of view; asks the worker for it and draws its answers.
import { turnedHead } from "./drives.mjs";
import { Quality } from "./quality.mjs";

const SETTLING = 250; // ms without a change after which the picture is drawn in full size

export class Stage {
  constructor({ canvas, client, description, neck, orbit, makeRenderer, fixedSize, onError }) {
    Object.assign(this, { canvas, client, description, neck, orbit, makeRenderer, fixedSize });
    Object.assign(this, { renderer: makeRenderer(), quality: new Quality(description.camera) });
    Object.assign(this, { pose: { yaw: 0, pitch: 0, roll: 0 }, shown: null, fence: null, changedAt: 0, isFull: false });
    Object.assign(this, { driveIsNew: true, viewIsNew: true, lost: false });
    client.listen((answer, request) => this.draw(answer, request), onError);
  }

  setDrive(drive) {
    this.drive = drive;
    this.driveIsNew = true;
  }

  setTurn(pose) {
    this.pose = pose;
    this.driveIsNew = true;
  }

  changeView() {
    this.viewIsNew = true;
  }

  // Whether nothing is left to compute or to draw.
  get idle() {
    return !this.driveIsNew && !this.viewIsNew && this.client.idle && !this.fence;
  }

  // Called for every picture of the display.
  tick(now) {
    this.checkFence(now);
    if (this.lost || !this.client.idle || this.fence) return;
    if (this.driveIsNew || this.viewIsNew) this.request(false, now);
    else if (!this.isFull && now - this.changedAt > SETTLING) this.request(true, now);
  }

  request(atRest, now) {
    const posed = turnedHead(this.drive, this.pose, this.description, this.neck);
    const view = this.orbit.view(posed);
    this.client.ask(this.driveIsNew ? posed : null, { numbers: view, intrinsics: posed.intrinsics, atRest });
    this.driveIsNew = this.viewIsNew = false;
    if (!atRest) this.changedAt = now;
  }

  draw(answer, { numbers, intrinsics, atRest }) {
    if (this.lost) return;
    const { camera } = this.description;
    const screen = this.canvas.clientWidth * (window.devicePixelRatio || 1);
    const full = this.quality.size(screen, true);
    const [width, height] = this.fixedSize || (atRest ? full : this.quality.size(screen, false));
    this.isFull = Boolean(this.fixedSize) || (width === full[0] && height === full[1]);
    this.renderer.resize(width, height);
    const [sx, sy] = [width / camera.width, height / camera.height];
    const [fx, fy, cx, cy] = intrinsics;
    this.started = performance.now();
    this.renderer.draw(answer, numbers, [fx * sx, fy * sy, cx * sx, cy * sy]);
    const { gl } = this.renderer;
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.wasAtRest = atRest;
    gl.flush();
  }

  // The next picture is asked for when the last one is on the screen.
  checkFence(now) {
    if (!this.fence) return;
    const { gl } = this.renderer;
    if (!gl.isContextLost() && gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return;
    gl.deleteSync(this.fence);
    this.fence = null;
    if (!this.wasAtRest) this.quality.note(performance.now() - this.started);
    else this.changedAt = now;
  }

  loseContext() {
    Object.assign(this, { lost: true, fence: null });
  }

  restoreContext() {
    Object.assign(this, { lost: false, renderer: this.makeRenderer(), driveIsNew: true, viewIsNew: true });
  }
}
