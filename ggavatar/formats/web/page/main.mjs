// The page: opens the avatar that it carries, and connects the controls to the stage.
import { Client } from "./client.mjs";
import { readCurves, Unreadable } from "./curves.mjs";
import { arkitDrive, clipDrive, restDrive } from "./drives.mjs";
import { listenToEmbedder } from "./embed.mjs";
import { listenToGestures } from "./gestures.mjs";
import { Orbit } from "./orbit.mjs";
import { element, Panel } from "./panel.mjs";
import { Player } from "./player.mjs";
import { NoWebGL, Renderer } from "./renderer.mjs";
import { Stage } from "./stage.mjs";

const SHADERS = ["splat.vert.glsl", "splat.frag.glsl", "whole.vert.glsl", "show.frag.glsl"];
const LONGEST_STEP = 1; // s of play-back between two pictures, however long they took

const at = (id) => document.getElementById(id);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)").matches;

function say(text, isFault = false) {
  at("status").textContent = text;
  at("status").classList.toggle("fault", isFault);
}

// The bytes of the file: base64 in the page, gzip inside.
async function carried() {
  const text = at("avatar") ? at("avatar").textContent.trim() : "";
  try {
    const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return await new Response(stream).arrayBuffer();
  } catch {
    throw new Error("The avatar in this page is incomplete or damaged. Save the page again.");
  }
}

// What tests and comparisons ask for in the address: ?test&width=128&height=128&target=byte
function asked() {
  const query = new URLSearchParams(location.search);
  const [width, height] = [Number(query.get("width")), Number(query.get("height"))];
  return { test: query.has("test"), eightBit: query.get("target") === "byte", size: width && height ? [width, height] : null };
}

class App {
  constructor(opened, client, wanted) {
    const { description, clips, joints } = opened;
    Object.assign(this, { description, player: new Player({ loops: !reducedMotion }), lastTime: 0, owed: 0 });
    const neck = Math.max(description.head.joint_names.indexOf("neck"), 0);
    this.orbit = new Orbit(description.controls.view, description.rest.center);
    const shaders = Object.fromEntries(SHADERS.map((name) => [name, at(name).textContent]));
    const options = { eightBit: wanted.eightBit, keep: wanted.test };
    this.stage = new Stage({
      canvas: at("picture"), client, description, orbit: this.orbit, fixedSize: wanted.size,
      neck: joints.slice(3 * neck, 3 * neck + 3),
      makeRenderer: () => new Renderer(at("picture"), shaders, opened, options),
      onError: (text) => say(text, true),
    });
    const change = (apply) => {
      this.pause();
      const drive = { ...this.stage.drive };
      apply(drive);
      this.stage.setDrive(drive);
    };
    const turn = (name, value) => this.stage.setTurn({ ...this.stage.pose, [name]: value });
    this.panel = new Panel(at("sliders"), description, { change, turn });
    this.performances = clips.map((clip) => ({
      name: clip.name, fps: clip.fps, length: clip.frames.length,
      drive: (position) => clipDrive(clip, position), label: (position) => String(clip.frames[Math.round(position)]),
    }));
    this.connect();
    if (clips.length) this.choose(0);
    else this.rest();
  }

  connect() {
    const canvas = at("picture");
    at("play").addEventListener("click", () => (this.player.playing ? this.pause() : this.play()));
    at("rest").addEventListener("click", () => this.rest());
    at("home").addEventListener("click", () => this.view(() => this.orbit.reset()));
    at("free").addEventListener("change", () => this.view(() => this.orbit.setFree(at("free").checked)));
    at("performance").addEventListener("change", () => this.choose(at("performance").selectedIndex));
    at("position").addEventListener("input", () => {
      this.pause();
      this.seek(Number(at("position").value));
    });
    at("file").addEventListener("change", () => at("file").files[0] && this.read(at("file").files[0]));
    listenToGestures(canvas, this.orbit, () => this.view(() => {}));
    new ResizeObserver(() => this.view(() => {})).observe(canvas);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.stage.loseContext();
      say("The browser took the graphics memory away; waiting for it to come back.");
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.stage.restoreContext();
      say("Ready.");
    });
    listenToDrops((file) => this.read(file));
    at("recording").hidden = !Object.keys(this.description.controls.arkit).length;
    this.listPerformances();
  }

  listPerformances() {
    at("performance").replaceChildren(...this.performances.map(({ name }) => element("option", { textContent: name })));
    for (const id of ["play", "performance", "position"]) at(id).disabled = !this.performances.length;
  }

  choose(index) {
    this.pause();
    this.player.choose(this.performances[index]);
    at("performance").selectedIndex = index;
    at("position").max = this.player.last;
    this.stage.setTurn({ yaw: 0, pitch: 0, roll: 0 });
    this.seek(0);
  }

  seek(position) {
    this.player.seek(position);
    this.showPlayer();
  }

  showPlayer() {
    const { player } = this;
    at("position").value = player.position;
    const label = player.performance.label(player.position);
    at("frame").textContent = label;
    at("position").setAttribute("aria-valuetext", `frame ${label}`);
    this.stage.setDrive(player.drive());
    this.panel.show(this.stage.drive, this.stage.pose);
  }

  play() {
    if (!this.player.performance) return;
    if (this.player.position >= this.player.last) this.player.seek(0);
    this.setPlaying(true);
  }

  pause() {
    this.setPlaying(false);
  }

  setPlaying(playing) {
    this.player.playing = playing;
    at("play").textContent = playing ? "Pause" : "Play";
    at("play").setAttribute("aria-pressed", String(playing));
  }

  rest() {
    this.pause();
    this.stage.setTurn({ yaw: 0, pitch: 0, roll: 0 });
    this.stage.setDrive(restDrive(this.description));
    this.panel.show(this.stage.drive, this.stage.pose);
  }

  view(action) {
    action();
    this.stage.changeView();
  }

  // A recording of ARKit's curves becomes one more performance.
  async read(file) {
    try {
      const { arkit } = this.description.controls;
      const { fps, frames, known } = readCurves(await file.text(), Object.keys(arkit));
      const drive = (position) => {
        const [before, after] = [Math.floor(position), Math.ceil(position)];
        const scores = {};
        for (const [name, score] of Object.entries(frames[before])) {
          scores[name] = score + (position - before) * (frames[after][name] - score);
        }
        return arkitDrive(this.description, scores);
      };
      const label = (position) => String(Math.round(position));
      this.performances.push({ name: file.name, fps, length: frames.length, drive, label });
      this.listPerformances();
      this.choose(this.performances.length - 1);
      say(`${file.name}: ${frames.length} frames, ${known} of ARKit's 52 curves. Press Play.`);
    } catch (error) {
      if (!(error instanceof Unreadable)) throw error;
      say(`${file.name} cannot be played: ${error.message}.`, true);
    }
  }

  // What an embedding page may do.
  get actions() {
    return {
      drive: (scores, pose) => {
        this.pause();
        this.stage.setTurn(pose);
        this.stage.setDrive(arkitDrive(this.description, scores));
        this.panel.show(this.stage.drive, this.stage.pose);
      },
      rest: () => this.rest(),
      pause: () => this.pause(),
      play: (name) => {
        const index = name === undefined ? at("performance").selectedIndex : this.performances.findIndex((one) => one.name === name);
        if (index < 0) return false;
        this.choose(index);
        this.play();
        return true;
      },
      view: ({ yaw = 0, pitch = 0, distance = 1 }) => this.view(() => {
        this.orbit.reset();
        this.orbit.turn(yaw, pitch);
        this.orbit.zoom(distance);
      }),
    };
  }

  tick(time) {
    const seconds = Math.min((time - this.lastTime) / 1000, LONGEST_STEP);
    this.lastTime = time;
    this.owed = this.player.playing ? Math.min(this.owed + seconds, LONGEST_STEP) : 0;
    if (this.stage.idle && this.player.playing) {
      if (this.player.advance(this.owed)) this.showPlayer();
      if (!this.player.playing) this.pause();
      this.owed = 0;
    }
    this.stage.tick(time);
    requestAnimationFrame((next) => this.tick(next));
  }
}

// Files may be dropped anywhere on the page.
function listenToDrops(take) {
  const over = (event) => {
    event.preventDefault();
    document.body.classList.toggle("dropping", event.type === "dragover");
  };
  for (const name of ["dragover", "dragleave"]) document.addEventListener(name, over);
  document.addEventListener("drop", (event) => {
    over(event);
    const [file] = event.dataTransfer.files;
    if (file) take(file);
  });
}

function introduce({ title, method, gaussians, head, created_by: by, camera }) {
  document.title = at("title").textContent = title;
  at("about").textContent =
    `${gaussians.toLocaleString("en")} Gaussians on the head ${head.version}, method ${method}, ${by.step} steps; ` +
    `written by GGAvatar ${by.ggavatar}. The page loads nothing and sends nothing.`;
  at("picture").style.setProperty("--aspect", camera.width / camera.height);
}

async function start() {
  const began = performance.now();
  const wanted = asked();
  document.body.classList.toggle("alone", location.hash === "#picture");
  const client = new Client(at("worker").textContent);
  const opened = await client.open(await carried());
  introduce(opened.description);
  at("controls").hidden = false;
  const app = new App(opened, client, wanted);
  app.stage.request(false, 0);
  requestAnimationFrame((time) => app.tick(time));
  const { embed, controls } = opened.description;
  listenToEmbedder(embed, app.actions, { arkit: Object.keys(controls.arkit), performances: app.performances.map(({ name }) => name) });
  while (!app.stage.idle) await new Promise((done) => setTimeout(done, 5));
  say(`Ready after ${((performance.now() - began) / 1000).toFixed(1)} s.`);
  if (wanted.test) window.ggavatar = app;
}

// The avatar's text comes behind this script, so that a page cut short still says what is wrong.
document.addEventListener("DOMContentLoaded", () => {
  start().catch((error) => {
    say(error.message, true);
    if (!(error instanceof NoWebGL)) console.warn(error);
  });
});
