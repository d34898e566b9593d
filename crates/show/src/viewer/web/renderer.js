// What both kinds of model are drawn with: the canvas, programs, and what layers need.

/** The layers, in the order of their numbers in layers.glsl. */
const LAYERS = ['color', 'depth', 'uncertainty', 'tinted'];
/** A triangle that covers the whole target. */
const WHOLE_TARGET = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1), 0, 1); }`;

/** Texture unit of the colour maps; models have those below it, targets those above. */
const MAPS = 3;

class Renderer {
  constructor(canvas, model) {
    // Screenshots are taken after drawing.
    const wanted = { antialias: false, preserveDrawingBuffer: true, powerPreference: 'high-performance' };
    const gl = canvas.getContext('webgl2', wanted);
    if (!gl) throw new Error('This browser offers no WebGL2, which draws the model.');
    if (gl.isContextLost()) throw new Error('The browser has taken the graphics context away: reload the page.');
    Object.assign(this, { gl, canvas, model });
    const { maps } = model.about;
    const rows = [maps.uncertainty, maps.depth].flat().flatMap((color) => [...color, 255]);
    this.texture2D(MAPS);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 2, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(rows));
  }

  program(vertices, fragments) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertices], [gl.FRAGMENT_SHADER, fragments]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const places = new Map();
    const place = (name) => places.get(name) ?? places.set(name, gl.getUniformLocation(program, name)).get(name);
    return { program, place };
  }

  /** Makes a texture of a unit, without interpolation. */
  texture2D(unit) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    }
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    }
    return texture;
  }

  /** Sets what layers.glsl reads. */
  prepareLayers(place, shown) {
    const { gl, model } = this;
    gl.uniform3f(place('background'), ...model.about.background);
    gl.uniform2f(place('range'), ...shown.range);
    gl.uniform2f(place('depths'), ...shown.depths.map((v) => v / model.unit));
    gl.uniform1i(place('layer'), LAYERS.indexOf(shown.layer));
    gl.uniform1f(place('split'), shown.split === null ? 0 : shown.split * gl.drawingBufferWidth);
    gl.uniform1i(place('maps'), MAPS);
  }

  /** Canvas pixel = xy + z * image pixel: the whole image of a camera, in the middle. */
  placing(camera, width, height) {
    const [w, h] = camera.resolution;
    const z = Math.min(width / w, height / h);
    // Rays pass through pixels at the place where the model was trained.
    const shift = z * (0.5 - this.model.about.pixelOffset);
    return [(width - z * w) / 2 + shift, (height - z * h) / 2 + shift, z];
  }

  /** Waits until everything is drawn. */
  finish() {
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
}
