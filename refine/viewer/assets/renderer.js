// Draws bodies, floors, lines and the loop's pictures with WebGL2. Throws where there is none.

const LIGHT = normalised([0.42, 0.88, 0.55]);
const SHADOW_SIZE = 1024;
const SHADOW_HALF = 1.7; // metres about the pelvis that cast shadows
const SCENES = {
  light: {
    inner: [0.992, 0.988, 0.976],
    outer: [0.914, 0.902, 0.875],
    floor: [0.957, 0.949, 0.929],
    line: [0.72, 0.7, 0.66],
    shade: [0.42, 0.41, 0.43],
    shadow: 0.62,
    sky: [0.62, 0.64, 0.68],
    ground: [0.34, 0.31, 0.29],
    strength: 0.78,
    rim: 0.16,
    plain: [0.83, 0.8, 0.75],
    ink: [0.17, 0.18, 0.26],
  },
  dark: {
    inner: [0.165, 0.172, 0.2],
    outer: [0.071, 0.075, 0.09],
    floor: [0.15, 0.157, 0.184],
    line: [0.36, 0.37, 0.42],
    shade: [0.02, 0.02, 0.03],
    shadow: 0.72,
    sky: [0.42, 0.45, 0.53],
    ground: [0.16, 0.15, 0.16],
    strength: 0.72,
    rim: 0.3,
    plain: [0.78, 0.76, 0.73],
    ink: [0.93, 0.93, 0.9],
  },
};

class Renderer {
  constructor(canvas, body, array) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "low-power" });
    if (!gl) throw new Error("no WebGL2");
    this.gl = gl;
    this.canvas = canvas;
    this.body = this.program(BODY_VERTEX, BODY_FRAGMENT);
    this.shadow = this.program(SHADOW_VERTEX, SHADOW_FRAGMENT);
    this.floor = this.program(FLOOR_VERTEX, FLOOR_FRAGMENT);
    this.back = this.program(BACK_VERTEX, BACK_FRAGMENT);
    this.line = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.picture = this.program(PICTURE_VERTEX, PICTURE_FRAGMENT);
    this.nothing = gl.createVertexArray();
    this.mesh = this.meshOf(body, array);
    this.lines = this.linesOf();
    this.quad = this.quadOf();
    this.map = this.shadowMap();
    this.sheets = new Map();
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA); // all colours are multiplied by their alpha
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error([gl.getProgramInfoLog(program), ...logs].join(" "));
    }
    const places = {};
    const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) || 0;
    for (let k = 0; k < count; k++) {
      const { name } = gl.getActiveUniform(program, k);
      places[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  use({ program, places }, values) {
    const { gl } = this;
    gl.useProgram(program);
    for (const [name, value] of Object.entries(values)) {
      const place = places[name];
      if (place === undefined) continue;
      if (typeof value === "number") gl.uniform1f(place, value);
      else if (name === "bones") gl.uniform4fv(place, value);
      else if (name === "tints") gl.uniform3fv(place, value);
      else if (value.length === 16) gl.uniformMatrix4fv(place, false, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
  }

  buffer(data, target = this.gl.ARRAY_BUFFER) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    gl.bindBuffer(target, buffer);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return buffer;
  }

  meshOf(body, array) {
    const { gl } = this;
    const positions = array(body.positions);
    const faces = array(body.faces);
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    this.buffer(positions);
    gl.vertexAttribPointer(0, 3, gl.SHORT, false, 0, 0);
    this.buffer(normalsOf(positions, faces));
    gl.vertexAttribPointer(1, 3, gl.FLOAT, false, 0, 0);
    this.buffer(array(body.joints));
    gl.vertexAttribIPointer(2, 4, gl.UNSIGNED_BYTE, 0, 0);
    this.buffer(array(body.weights));
    gl.vertexAttribPointer(3, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    for (let k = 0; k < 4; k++) gl.enableVertexAttribArray(k);
    this.buffer(faces, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    const type = faces instanceof Uint32Array ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
    return { vao, count: faces.length, type, unit: body.scale };
  }

  linesOf() {
    const { gl } = this;
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    let at = 0;
    [3, 3, 4, 1].forEach((size, place) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 44, at);
      gl.vertexAttribDivisor(place, 1);
      at += 4 * size;
    });
    gl.bindVertexArray(null);
    return { vao, buffer };
  }

  quadOf() {
    const { gl } = this;
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
    return { vao, buffer };
  }

  shadowMap() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return { texture, frame };
  }

  // The light's view of all actors.
  castShadows(actors, about) {
    const { gl } = this;
    const target = [about[0], 0.8, about[2]];
    const light = product(orthographic(SHADOW_HALF, 0.5, 9), looking(add(target, scaled(LIGHT, 4.5)), target));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.map.frame);
    gl.viewport(0, 0, SHADOW_SIZE, SHADOW_SIZE);
    gl.disable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1.5, 3);
    gl.bindVertexArray(this.mesh.vao);
    for (const { bones } of actors) {
      this.use(this.shadow, { bones, light, unit: this.mesh.unit });
      gl.drawElements(gl.TRIANGLES, this.mesh.count, this.mesh.type, 0);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return light;
  }

  // One panel: `box` (x, y, width, height) in pixels from the lower left; `actors` have bones, joints and tints; lines
  // lie under, among and over them, and `pictures` stand in the world.
  draw({ box, eye, camera, centre, actors, under, among, over, pictures, seeThrough }, scene) {
    const { gl } = this;
    const light = this.castShadows(actors, centre);
    gl.viewport(...box);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(...box);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.map.texture);

    gl.bindVertexArray(this.nothing);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    this.use(this.back, { inner: scene.inner, outer: scene.outer });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.enable(gl.BLEND);
    const below = actors.length === 1 ? actors[0].joints.slice(0, 3) : [0, 100, 0];
    const floor = { camera, light, centre, below, reach: 7, base: scene.floor, line: scene.line, shade: scene.shade };
    this.use(this.floor, { ...floor, shadow: scene.shadow });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    this.drawLines(under, camera, box);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);

    gl.bindVertexArray(this.mesh.vao);
    const common = { camera, light, eye, key: LIGHT, sky: scene.sky, ground: scene.ground, unit: this.mesh.unit };
    const look = { ...common, strength: scene.strength, rim: scene.rim, opacity: seeThrough ? 0.42 : 1 };
    for (const passes of seeThrough ? [false, true] : [true]) {
      gl.colorMask(passes, passes, passes, passes); // seen through, only the nearest surface shows
      gl.depthFunc(seeThrough ? gl.LEQUAL : gl.LESS);
      gl.enable(gl.POLYGON_OFFSET_FILL);
      actors.forEach(({ bones, tints }, k) => {
        gl.polygonOffset(-k, -24 * k); // where bodies coincide, the later is seen
        this.use(this.body, { ...look, bones, tints });
        gl.drawElements(gl.TRIANGLES, this.mesh.count, this.mesh.type, 0);
      });
      gl.disable(gl.POLYGON_OFFSET_FILL);
    }
    gl.depthFunc(gl.LESS);
    gl.disable(gl.CULL_FACE);
    for (const one of pictures) this.drawPicture(one, camera);
    gl.depthMask(false);
    this.drawLines(among, camera, box);
    gl.disable(gl.DEPTH_TEST);
    this.drawLines(over, camera, box);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  // Lines as [start, end, [r, g, b, alpha], pixels].
  drawLines(lines, camera, box) {
    if (!lines.length) return;
    const { gl } = this;
    gl.bindVertexArray(this.lines.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lines.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(lines.flat(2)), gl.STREAM_DRAW);
    this.use(this.line, { camera, pixels: [box[2], box[3]] });
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, lines.length);
  }

  // A window (left, top, width, height in 0..1) of a sheet, stretched between four corners, clockwise from top left.
  drawPicture({ url, corners: [a, b, c, d], window, paper, veil }, camera) {
    const { gl } = this;
    const texture = this.sheet(url);
    if (!texture) return;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.bindVertexArray(this.quad.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.quad.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([a, b, d, c].flat()), gl.STREAM_DRAW);
    this.use(this.picture, { camera, window, paper, veil });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  // The texture of a data URL once the browser has read it; `arrived` is called then.
  sheet(url) {
    const { gl } = this;
    if (!this.sheets.has(url)) {
      this.sheets.set(url, null);
      const image = new Image();
      image.onload = () => {
        const texture = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
        gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
        this.sheets.set(url, texture);
        this.arrived?.();
      };
      image.src = url;
    }
    return this.sheets.get(url);
  }
}

// Unit normals at vertices, faces weighed by their area.
function normalsOf(positions, faces) {
  const normals = new Float32Array(positions.length);
  const corner = (face, k) => positions.subarray(3 * faces[face + k], 3 * faces[face + k] + 3);
  for (let face = 0; face < faces.length; face += 3) {
    const [a, b, c] = [corner(face, 0), corner(face, 1), corner(face, 2)];
    const normal = cross(subtract(b, a), subtract(c, a));
    for (let k = 0; k < 3; k++)
      for (let axis = 0; axis < 3; axis++) normals[3 * faces[face + k] + axis] += normal[axis];
  }
  for (let at = 0; at < normals.length; at += 3) normals.set(normalised(normals.subarray(at, at + 3)), at);
  return normals;
}
