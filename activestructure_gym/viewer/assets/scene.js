"use strict";
// Draw the map, lines and points with WebGL2. Positions are in metres, z is up.

const MAP_VERTEX = `#version 300 es
layout(location = 0) in vec3 mean;      // 0..1 of the box around all Gaussians
layout(location = 1) in vec3 scale;     // steps of the logarithm
layout(location = 2) in vec4 rotation;  // wxyz
layout(location = 3) in vec3 colour;
layout(location = 4) in vec2 span;      // frames: added, removed
uniform mat4 view, projection;
uniform vec3 low, side;
uniform vec2 logs;
uniform float focal;
uniform float now, cut, widen;
flat out vec3 conic;
flat out vec3 shade;
flat out float size;
void main() {
  vec3 place = low + side * mean;
  vec4 seen = view * vec4(place, 1.0);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = 1.0;
  conic = vec3(1.0, 0.0, 1.0); shade = colour; size = 1.0;
  if (span.x > now || span.y <= now || place.z > cut || seen.z > -0.05) return;
  vec3 s = exp(logs.x + logs.y * scale) * widen;
  vec4 q = normalize(rotation);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  mat3 r = mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
  mat3 m = mat3(view) * r * mat3(s.x, 0.0, 0.0, 0.0, s.y, 0.0, 0.0, 0.0, s.z);
  float d = -seen.z;
  vec3 a = vec3(m[0][0], m[1][0], m[2][0]), b = vec3(m[0][1], m[1][1], m[2][1]), c = vec3(m[0][2], m[1][2], m[2][2]);
  vec3 u = focal * (a / d + c * seen.x / (d * d)), v = focal * (b / d + c * seen.y / (d * d));
  float uu = dot(u, u) + 0.3, uv = dot(u, v), vv = dot(v, v) + 0.3;
  float mid = 0.5 * (uu + vv), far = mid + sqrt(max(mid * mid - (uu * vv - uv * uv), 0.0));
  size = clamp(2.0 * 1.7 * sqrt(far), 1.0, 96.0);
  float det = max(uu * vv - uv * uv, 1e-6);
  conic = vec3(vv, -uv, uu) / det;
  gl_Position = projection * seen;
  gl_PointSize = size;
}`;

const MAP_FRAGMENT = `#version 300 es
precision mediump float;
flat in highp vec3 conic;
flat in vec3 shade;
flat in float size;
out vec4 result;
void main() {
  highp vec2 p = (gl_PointCoord - 0.5) * vec2(size, -size);
  highp float power = conic.x * p.x * p.x + 2.0 * conic.y * p.x * p.y + conic.z * p.y * p.y;
  if (power > 2.9) discard;
  result = vec4(shade, 1.0);
}`;

const POINT_VERTEX = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec4 tint;
uniform mat4 view, projection;
uniform float point;
out vec4 shade;
void main() { gl_Position = projection * view * vec4(place, 1.0); gl_PointSize = point; shade = tint; }`;

// A line of some width: a strip of four vertices per instance, which has the two ends.
const LINE_VERTEX = `#version 300 es
layout(location = 0) in vec3 from;
layout(location = 1) in vec4 tint;
layout(location = 2) in vec3 to;
uniform mat4 view, projection;
uniform vec2 screen;
uniform float point;
out vec4 shade;
void main() {
  vec4 a = projection * view * vec4(from, 1.0), b = projection * view * vec4(to, 1.0);
  const float near = 0.05;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  shade = tint;
  if (a.w < near && b.w < near) return;
  if (a.w < near) a = mix(a, b, (near - a.w) / (b.w - a.w));
  if (b.w < near) b = mix(b, a, (near - b.w) / (a.w - b.w));
  vec2 along = (b.xy / b.w - a.xy / a.w) * screen;
  vec2 across = length(along) > 0.0 ? normalize(vec2(-along.y, along.x)) : vec2(0.0, 1.0);
  gl_Position = gl_VertexID < 2 ? a : b;
  gl_Position.xy += ((gl_VertexID & 1) == 0 ? 1.0 : -1.0) * across * point / screen * gl_Position.w;
}`;

const FLAT_FRAGMENT = `#version 300 es
precision mediump float;
in vec4 shade;
uniform float faint;
out vec4 result;
void main() { result = vec4(shade.rgb, shade.a * faint); }`;

const COPY_VERTEX = `#version 300 es
out vec2 at;
void main() { at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0; gl_Position = vec4(at * 2.0 - 1.0, 0.0, 1.0); }`;

const COPY_FRAGMENT = `#version 300 es
precision mediump float;
in vec2 at;
uniform sampler2D colours;
uniform vec2 part;
uniform highp sampler2D depths;
out vec4 result;
void main() { result = texture(colours, at * part); gl_FragDepth = texture(depths, at * part).r; }`;

const SKIPPED = 4; // while the view is dragged, one of this many Gaussians is drawn, enlarged
const COARSE = 0.5; // scale of the image while the view is dragged

const LATE_MS = 500; // during playback, the whole map is redrawn without removed Gaussians at most this often

class SceneView {
  constructor(canvas, recording) {
    this.canvas = canvas;
    this.recording = recording;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("this browser has no WebGL2, which the viewer needs");
    this.gl = gl;
    this.programs = {
      map: this.program(MAP_VERTEX, MAP_FRAGMENT),
      line: this.program(LINE_VERTEX, FLAT_FRAGMENT),
      point: this.program(POINT_VERTEX, FLAT_FRAGMENT),
      copy: this.program(COPY_VERTEX, COPY_FRAGMENT),
    };
    this.load();
    this.lineBuffer = gl.createBuffer();
    this.overlays = [false, true].map((instanced) => { // of points and faces, and of lines
      const vao = gl.createVertexArray(), stride = instanced ? 56 : 28;
      gl.bindVertexArray(vao);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
      [[3, 0], [4, 12], [3, 28]].slice(0, instanced ? 3 : 2).forEach(([size, offset], place) => {
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
        gl.vertexAttribDivisor(place, instanced ? 1 : 0);
      });
      return vao;
    });
    gl.bindVertexArray(null);
  }

  load() { // upload the recording's map
    const gl = this.gl, { added, removed } = this.recording.arrays;
    for (const vao of this.maps || []) gl.deleteVertexArray(vao);
    for (const { buffer } of this.buffers || []) gl.deleteBuffer(buffer);
    this.count = added.length;
    this.buffers = this.upload();
    this.maps = [1, SKIPPED].map((step) => this.every(step));
    this.kept = null; // camera and frame of the stored image
    this.removals = Array.from(removed).filter((frame) => frame < this.recording.never_removed).sort((a, b) => a - b);
  }

  program(vertex, fragment) {
    const gl = this.gl, made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(made, i).name;
      places[name] = gl.getUniformLocation(made, name);
    }
    return { made, places };
  }

  upload() {
    const gl = this.gl, a = this.recording.arrays;
    // Two bytes per frame number if they suffice; else float, exact up to 16 million.
    const short = a.added instanceof Uint16Array, span = new (short ? Uint16Array : Float32Array)(2 * this.count);
    for (let i = 0; i < this.count; i++) { span[2 * i] = a.added[i]; span[2 * i + 1] = a.removed[i]; }
    return [[a.means, 3, gl.UNSIGNED_SHORT, true], [a.scales, 3, gl.UNSIGNED_BYTE, false],
      [a.rotations, 4, gl.BYTE, true], [a.colours, 3, gl.UNSIGNED_BYTE, true], [span, 2, short ? gl.UNSIGNED_SHORT : gl.FLOAT, false]].map(([data, size, kind, whole]) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      return { buffer, size, kind, whole, bytes: size * data.BYTES_PER_ELEMENT };
    });
  }

  // Vertex array of every Gaussian, or of every ``step``-th one while the view is dragged.
  every(step) {
    const gl = this.gl, vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    this.buffers.forEach(({ buffer, size, kind, whole, bytes }, place) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, kind, whole, step * bytes, 0);
    });
    gl.bindVertexArray(null);
    return vao;
  }

  resize() {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 1.5);
    const width = Math.max(2, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(2, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width === width && this.canvas.height === height && this.target) return;
    this.canvas.width = width;
    this.canvas.height = height;
    if (this.target) for (const part of [this.colours, this.depths]) gl.deleteTexture(part);
    this.target = this.target || gl.createFramebuffer();
    const texture = (inner, format, kind) => {
      const made = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, made);
      gl.texStorage2D(gl.TEXTURE_2D, 1, inner, width, height);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
      return made;
    };
    this.colours = texture(gl.RGBA8);
    this.depths = texture(gl.DEPTH_COMPONENT24);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.colours, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depths, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.kept = null;
  }

  // Number of Gaussians added by a frame. They are sorted by the frame of addition.
  addedBy(frame) {
    const added = this.recording.arrays.added;
    let low = 0, high = this.count;
    while (low < high) { const mid = (low + high) >> 1; if (added[mid] <= frame) low = mid + 1; else high = mid; }
    return low;
  }

  countAt(frame) {
    return this.addedBy(frame) - this.removals.filter((removal) => removal <= frame).length;
  }

  removedBetween(first, last) {
    return this.removals.some((frame) => frame > first && frame <= last);
  }

  // camera: {view, projection, focal, key}; shown: {map, cut}; overlay: Float32Array of lines and of points
  draw(camera, frame, shown, overlay, background) {
    const gl = this.gl;
    this.resize();
    const key = `${camera.key}|${shown.map}|${shown.cut}|${background.join()}|${shown.coarse}`;
    const goesOn = this.kept && this.kept.key === key && this.kept.frame <= frame;
    const stale = goesOn && (this.kept.stale || this.removedBetween(this.kept.frame, frame));
    const grows = goesOn && (!stale || (shown.playing && performance.now() - this.whole < LATE_MS));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    const share = shown.coarse ? COARSE : 1, wide = Math.floor(share * this.canvas.width), tall = Math.floor(share * this.canvas.height);
    gl.viewport(0, 0, wide, tall);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    if (!grows) {
      gl.clearColor(...background, 1.0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      this.whole = performance.now();
    }
    const first = grows ? this.addedBy(this.kept.frame) : 0, last = this.addedBy(frame);
    if (shown.map && last > first) this.drawMap(camera, frame, shown.cut, tall, first, last, shown.coarse);
    this.kept = { key, frame, stale: grows && stale };
    this.drawn = shown.map ? last : 0;

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.depthFunc(gl.ALWAYS);
    gl.useProgram(this.programs.copy.made);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.depths);
    gl.uniform1i(this.programs.copy.places.colours, 0);
    gl.uniform1i(this.programs.copy.places.depths, 1);
    gl.uniform2f(this.programs.copy.places.part, wide / this.canvas.width, tall / this.canvas.height);
    gl.bindVertexArray(null);
    gl.drawArrays(gl.TRIANGLES, 0, 3);

    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    const ratio = Math.min(window.devicePixelRatio || 1, 1.5), { faces, lines, strokes, points } = overlay;
    for (const [kind, data, width] of [[gl.TRIANGLES, faces, 1], [gl.LINES, lines, 1.4], [gl.LINES, strokes, 3], [gl.POINTS, points, 7]]) {
      if (!data.length) continue;
      const { made, places } = kind === gl.LINES ? this.programs.line : this.programs.point;
      gl.useProgram(made);
      gl.bindVertexArray(this.overlays[kind === gl.LINES ? 1 : 0]);
      gl.uniformMatrix4fv(places.view, false, camera.view);
      gl.uniformMatrix4fv(places.projection, false, camera.projection);
      gl.uniform1f(places.point, width * ratio);
      if (places.screen) gl.uniform2f(places.screen, this.canvas.width, this.canvas.height);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(data), gl.DYNAMIC_DRAW);
      // What is behind the map shows faintly through it.
      for (const [test, faint] of [[gl.ALWAYS, kind === gl.TRIANGLES ? 0.25 : 0.35], [gl.LEQUAL, 1.0]]) {
        gl.depthFunc(test);
        gl.uniform1f(places.faint, faint);
        if (kind === gl.LINES) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, data.length / 14);
        else gl.drawArrays(kind, 0, data.length / 7);
      }
    }
    gl.depthMask(true);
  }

  // Draw the Gaussians with the numbers from ``first`` to ``last`` into the current framebuffer of a height in pixels.
  drawMap(camera, frame, cut, tall, first, last, coarse) {
    const gl = this.gl, { made, places } = this.programs.map, recording = this.recording;
    gl.useProgram(made);
    gl.uniformMatrix4fv(places.view, false, camera.view);
    gl.uniformMatrix4fv(places.projection, false, camera.projection);
    gl.uniform3fv(places.low, recording.low);
    gl.uniform3fv(places.side, recording.side);
    gl.uniform2fv(places.logs, recording.log);
    gl.uniform1f(places.focal, camera.focal * tall);
    gl.uniform1f(places.now, frame);
    gl.uniform1f(places.cut, cut);
    const step = coarse ? SKIPPED : 1, begin = Math.floor(first / step);
    gl.uniform1f(places.widen, Math.sqrt(step));
    gl.bindVertexArray(this.maps[coarse ? 1 : 0]);
    gl.drawArrays(gl.POINTS, begin, Math.floor(last / step) - begin);
  }

  // Draw the map at a frame, seen by another camera, into a canvas of its own.
  preview(camera, frame, canvas, background) {
    const gl = this.gl, { width, height } = canvas, target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    const parts = [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]].map(([format, place]) => {
      const made = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, made);
      gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, made);
      return made;
    });
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.depthFunc(gl.LESS);
    gl.clearColor(...background, 1.0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawMap(camera, frame, 1e6, height, 0, this.addedBy(frame), false);
    const pixels = new Uint8ClampedArray(4 * width * height), image = new ImageData(width, height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    for (let row = 0; row < height; row++) // WebGL's first row is the lowest
      image.data.set(pixels.subarray(4 * width * (height - 1 - row), 4 * width * (height - row)), 4 * width * row);
    canvas.getContext("2d").putImageData(image, 0, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    for (const part of parts) gl.deleteRenderbuffer(part);
    gl.deleteFramebuffer(target);
  }
}

// -- cameras: column-major 4x4 matrices ----------------------------------------------------------------------------

function viewMatrix(eye, right, up, back) {
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  return new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
}

function perspective(focal, aspect, near, far) {
  return new Float32Array([2 * focal / aspect, 0, 0, 0, 0, 2 * focal, 0, 0, 0, 0, -(far + near) / (far - near), -1,
    0, 0, -2 * far * near / (far - near), 0]);
}

class Orbit {
  constructor(bounds, start) { // seen from the corner nearest to the camera's first position
    const [low, high] = bounds, side = [0, 1].map((axis) => start[axis] - (low[axis] + high[axis]) / 2), turn = Math.PI / 2;
    this.target = [0, 1, 2].map((axis) => low[axis] + (axis < 2 ? 0.5 : 0.25) * (high[axis] - low[axis])); // the ceiling is hidden
    this.size = Math.hypot(high[0] - low[0], high[1] - low[1]);
    this.home = { yaw: 0.94 + turn * Math.round((Math.atan2(side[1], side[0]) - 0.94) / turn), pitch: 0.95, distance: this.size * 1.25, target: [...this.target] };
    this.reset();
  }
  reset() { Object.assign(this, { ...this.home, target: [...this.home.target] }); }
  axes() {
    const cp = Math.cos(this.pitch), sp = Math.sin(this.pitch), cy = Math.cos(this.yaw), sy = Math.sin(this.yaw);
    return { back: [cp * cy, cp * sy, sp], right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp] };
  }
  camera(aspect) {
    const { back, right, up } = this.axes();
    const away = this.distance * Math.max(1, 1.3 / aspect); // a tall image shows as much as a wide one
    const eye = this.target.map((value, axis) => value + away * back[axis]);
    const focal = 1.1;
    return { view: viewMatrix(eye, right, up, back), projection: perspective(focal, aspect, 0.05, 400),
      focal, key: [this.yaw, this.pitch, away, ...this.target].join() };
  }
  turn(x, y) {
    this.yaw -= 0.006 * x;
    this.pitch = Math.min(1.56, Math.max(-1.2, this.pitch + 0.006 * y));
  }
  shift(x, y, height) {
    const { right, up } = this.axes(), step = this.distance / height;
    this.target = this.target.map((value, axis) => value - step * x * right[axis] + step * y * up[axis]);
  }
  zoom(steps) { this.distance = Math.min(200, Math.max(0.3, this.distance * Math.exp(0.0012 * steps))); }
}
