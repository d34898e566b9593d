// Splats on the GPU: ellipses from the farthest to the nearest, blended into two targets, of which layers are made.

/** Texels of a splat, and splats in a row of their texture. */
const TEXELS = 4;
const ROW = 512;
/** Texture units. */
const SPLATS = 0;
const ORDER = 1;
const TARGETS = 4;

class SplatsRenderer extends Renderer {
  constructor(canvas, splats) {
    super(canvas, splats);
    const { gl } = this;
    const extensions = ['EXT_color_buffer_float', 'EXT_color_buffer_half_float'];
    if (!extensions.map((name) => gl.getExtension(name)).some((found) => found)) {
      throw new Error('This browser cannot blend numbers of 16 bits (WebGL2 with EXT_color_buffer_float).');
    }
    const shader = (...names) => `#version 300 es\n${names.map((name) => byId(name).textContent).join('\n')}`;
    this.ellipses = this.program(shader('splats-vertex'), shader('splats-fragment'));
    this.resolve = this.program(WHOLE_TARGET, shader('layers', 'splats-resolve'));
    this.upload();
    this.target = gl.createFramebuffer();
    this.sums = [0, 1].map((k) => this.texture2D(TARGETS + k));
  }

  upload() {
    const { gl, model } = this;
    const rows = Math.ceil(model.about.count / ROW);
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (rows > most || TEXELS * ROW > most) {
      throw new Error(`This device holds ${most * ROW} splats, and the file has ${model.about.count}.`);
    }
    const texels = new Float32Array(4 * TEXELS * ROW * rows);
    const { means, covariances, colors, opacities, log10U, unseen } = model;
    for (let i = 0; i < model.about.count; i++) {
      const at = 4 * TEXELS * i;
      texels.set(means.subarray(3 * i, 3 * i + 3), at);
      texels[at + 3] = opacities[i];
      texels.set(covariances.subarray(6 * i, 6 * i + 6), at + 4);
      texels[at + 10] = this.share(log10U[i]);
      texels[at + 11] = unseen[i];
      texels.set(colors.subarray(3 * i, 3 * i + 3), at + 12);
    }
    this.texture2D(SPLATS);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, TEXELS * ROW, rows, 0, gl.RGBA, gl.FLOAT, texels);
    this.texture2D(ORDER);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.R32UI, ROW, rows);
    this.order = new Uint32Array(ROW * rows);
    // Two triangles a splat in one call: instances of four vertices are slow, most of all without a graphics card.
    const corners = Uint32Array.from({ length: 6 * model.about.count }, (_, k) =>
      4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  }

  /** log10 U in parts of its range, which 16 bits hold better. */
  share(log10U) {
    const { codes, prior } = this.model.about;
    return (log10U - codes.low) / (prior - codes.low);
  }

  /** A camera as splats are projected: rows right, down and forward; shapes are limited by the whole canvas. */
  lens(camera) {
    const { width, height } = this.canvas;
    const [x, y, z] = this.placing(camera, width, height);
    return this.model.lens(camera, ...[[0, 0], [width, height]].map(([u, v]) => [(u - x) / z, (v - y) / z]));
  }

  draw(camera, shown) {
    const { gl, canvas } = this;
    const { width, height } = canvas;
    const placing = this.placing(camera, width, height);
    this.blend(camera, shown, placing);
    const { program, place } = this.resolve;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(program);
    this.prepareLayers(place, shown);
    this.prepareLens(place, camera, placing);
    const { codes, prior } = this.model.about;
    gl.uniform2f(place('codes'), codes.low, prior);
    ['light', 'knowledge'].forEach((name, k) => gl.uniform1i(place(name), TARGETS + k));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Blends the splats into the two targets. */
  blend(camera, shown, placing) {
    const { gl, canvas, model } = this;
    const { width, height } = canvas;
    const list = model.listed(camera, shown);
    this.fitTargets(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const { program, place } = this.ellipses;
    gl.useProgram(program);
    this.prepareLens(place, camera, placing);
    const { eye, rows, limits } = this.lens(camera);
    gl.uniform3f(place('eye'), ...eye);
    gl.uniformMatrix3fv(place('toScene'), false, rows.flat());
    gl.uniform4f(place('limits'), ...limits.flat());
    gl.uniform2f(place('canvas'), width, height);
    gl.uniform1i(place('isMip'), model.about.isMip ? 1 : 0);
    gl.uniform1f(place('dilation'), model.about.dilation);
    gl.uniform1f(place('faintest'), model.about.drawn.faintest);
    gl.uniform1f(place('mostOpaque'), model.about.drawn.mostOpaque);
    gl.uniform1f(place('unit'), model.unit);
    gl.uniform1i(place('splats'), SPLATS);
    gl.uniform1i(place('order'), ORDER);
    this.uploadOrder(list);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawElements(gl.TRIANGLES, 6 * list.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.BLEND);
  }

  /** Gives the shader the splats in the order in which they are drawn. */
  uploadOrder(list) {
    const { gl, order } = this;
    if (list === this.listed) return;
    this.listed = list;
    order.set(list);
    gl.activeTexture(gl.TEXTURE0 + ORDER);
    const rows = Math.ceil(list.length / ROW);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ROW, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
  }

  /** Sets what both programs share. */
  prepareLens(place, camera, placing) {
    const { gl, canvas } = this;
    gl.uniform2f(place('focal'), ...camera.focal);
    gl.uniform2f(place('principal'), ...camera.center);
    gl.uniform3f(place('placing'), ...placing);
    gl.uniform1f(place('canvasHeight'), canvas.height);
  }

  /** Gives the targets the size of the canvas. */
  fitTargets(width, height) {
    const { gl } = this;
    if (this.size?.[0] === width && this.size?.[1] === height) return;
    this.size = [width, height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    const places = this.sums.map((texture, k) => {
      gl.activeTexture(gl.TEXTURE0 + TARGETS + k);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.HALF_FLOAT, null);
      const place = gl.COLOR_ATTACHMENT0 + k;
      gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, texture, 0);
      return place;
    });
    gl.drawBuffers(places);
  }

  /** Opacity, depth (scene units), log10 U and number of splats of the pixels of a target, from the top left. */
  measure(camera, shown, width, height, placing) {
    const place = placing ?? this.placing(camera, width, height);
    const pixels = this.model.pixels(camera, shown, this.lens(camera), width, height, place);
    return Float32Array.from(pixels.flatMap(({ opacity, depth, log10U, count }) => [opacity, depth, log10U, count]));
  }

  /** What is under an image point; null if nothing is hit. */
  read(camera, shown, x, y) {
    // A target of one pixel, in whose middle the point lies.
    const [pixel] = this.model.pixels(camera, shown, this.lens(camera), 1, 1, [0.5 - x, 0.5 - y, 1]);
    const { opacity, depth, log10U, unseen, count } = pixel;
    if (opacity <= 0.5) return null;
    const more = [`opacity ${words(opacity)}, splats here: ${count}`];
    return { position: camera.point([x, y], depth), depth, log10U, isUnseen: unseen > 0.5, more };
  }
}
