// Play-back of performances. A performance is {name, fps, length, drive(position), label(position)}; positions are frames.

export class Player {
  // `loops`: whether play-back begins again at its end.
  constructor({ loops }) {
    Object.assign(this, { loops, performance: null, position: 0, playing: false });
  }

  choose(performance) {
    Object.assign(this, { performance, position: 0 });
  }

  seek(position) {
    this.position = Math.min(Math.max(position, 0), this.last);
  }

  get last() {
    return Math.max(this.performance.length - 1, 0);
  }

  // Advance by a time, s; whether the picture changes.
  advance(seconds) {
    if (!this.playing || !this.last) return false;
    const next = this.position + seconds * this.performance.fps;
    this.position = next <= this.last ? next : this.loops ? next % this.last : this.last;
    if (next > this.last && !this.loops) this.playing = false;
    return true;
  }

  drive() {
    return this.performance.drive(this.position);
  }
}
