// Draws the avatar with WebGL2: one instance a Gaussian, front to back into a half-float target, then on the background.

const TEXTURE_WIDTH = 2048; // texels; textures are the tables that the vertex shader reads
const UNITS = { placed: 0, appearance: 1, image: 2 };
const MAIN_NUMBERS = 4; // of a texel

export class NoWebGL extends Error {}

export class Renderer {
  // `options.eightBit`: draw into 8 bits even where half floats are possible; `options.keep`: keep the picture for reading.
  constructor(canvas, shaders, { description, texels, stride }, options = {}) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: Boolean(options.keep) });
    if (!gl) throw new NoWebGL("This browser has no WebGL2, which draws the avatar. Try another or a newer one.");
    Object.assign(this, { canvas, gl, count: description.gaussians, background: description.background });
    const half = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    this.format = half && !options.eightBit ? gl.RGBA16F : gl.RGBA8;
    const coefficients = (description.sh_degree + 1) ** 2;
    const defines = { TEXTURE_WIDTH, POSED: stride / MAIN_NUMBERS, COEFFICIENTS: coefficients };
    this.splat = program(gl, defined(shaders["splat.vert.glsl"], defines), shaders["splat.frag.glsl"]);
    this.show = program(gl, shaders["whole.vert.glsl"], shaders["show.frag.glsl"]);
    table(gl, UNITS.placed, (stride / MAIN_NUMBERS) * this.count);
    table(gl, UNITS.appearance, coefficients * this.count);
    fill(gl, UNITS.appearance, texels);
    this.order = instances(gl, this.count);
    this.empty = gl.createVertexArray();
    this.target = gl.createFramebuffer();
  }

  resize(width, height) {
    const { gl, canvas } = this;
    if (this.image && canvas.width === width && canvas.height === height) return;
    Object.assign(canvas, { width, height });
    if (this.image) gl.deleteTexture(this.image);
    this.image = texture(gl, UNITS.image, this.format, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.image, 0);
  }

  // `placed` is null where only the view has changed; `camera` is focal lengths and principal point in px of the canvas.
  draw({ placed, order }, view, camera) {
    const { gl } = this;
    if (placed) fill(gl, UNITS.placed, placed);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order.buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, order);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    this.drawSplats(view, camera);
    this.drawBackground();
  }

  drawSplats(view, camera) {
    const { gl, splat } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(splat.program);
    gl.bindVertexArray(this.order.array);
    gl.uniform1i(splat.at("placed"), UNITS.placed);
    gl.uniform1i(splat.at("appearance"), UNITS.appearance);
    gl.uniformMatrix4fv(splat.at("view"), true, [...view, 0, 0, 0, 1]);
    gl.uniform4f(splat.at("camera"), ...camera);
    gl.uniform2f(splat.at("size"), this.canvas.width, this.canvas.height);
    gl.uniform3f(splat.at("eye"), ...[0, 1, 2].map((i) => -(view[i] * view[3] + view[4 + i] * view[7] + view[8 + i] * view[11])));
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE); // what is in front lets through 1 - its alpha
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    gl.disable(gl.BLEND);
  }

  drawBackground() {
    const { gl, show } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(show.program);
    gl.bindVertexArray(this.empty);
    gl.uniform1i(show.at("image"), UNITS.image);
    gl.uniform3f(show.at("background"), ...this.background);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

// A shader with constants behind its first line, which must be its version.
function defined(source, constants) {
  const [version, ...rest] = source.split("\n");
  const lines = Object.entries(constants).map(([name, value]) => `#define ${name} ${value}`);
  return [version, ...lines, ...rest].join("\n");
}

function program(gl, vertex, fragment) {
  const linked = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(linked, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new NoWebGL(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(linked);
  if (!gl.getProgramParameter(linked, gl.LINK_STATUS) && !gl.isContextLost()) throw new NoWebGL(gl.getProgramInfoLog(linked));
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(linked, name));
    return places.get(name);
  };
  return { program: linked, at };
}

function texture(gl, unit, format, width, height) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return made;
}

function table(gl, unit, texels) {
  texture(gl, unit, gl.RGBA32F, TEXTURE_WIDTH, Math.ceil(texels / TEXTURE_WIDTH));
}

// Whole rows in one call, and what is left of the last row in another.
function fill(gl, unit, data) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  const texels = data.length / MAIN_NUMBERS;
  const rows = Math.floor(texels / TEXTURE_WIDTH);
  const rest = texels % TEXTURE_WIDTH;
  if (rows) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXTURE_WIDTH, rows, gl.RGBA, gl.FLOAT, data);
  if (rest) {
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, rows, rest, 1, gl.RGBA, gl.FLOAT, data, rows * TEXTURE_WIDTH * MAIN_NUMBERS);
  }
}

// One index an instance: which Gaussian is drawn.
function instances(gl, count) {
  const array = gl.createVertexArray();
  const buffer = gl.createBuffer();
  gl.bindVertexArray(array);
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, 4 * count, gl.DYNAMIC_DRAW);
  gl.enableVertexAttribArray(0);
  gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
  gl.vertexAttribDivisor(0, 1);
  return { array, buffer };
}
