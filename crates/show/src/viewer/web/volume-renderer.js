// The volume on the GPU: textures, the two programs, and what comes back.

class VolumeRenderer extends Renderer {
  constructor(canvas, volume) {
    super(canvas, volume);
    const march = byId('layers').textContent + byId('march').textContent;
    this.picture = this.program(WHOLE_TARGET, `#version 300 es\n${march}`);
    this.numbers = this.program(WHOLE_TARGET, `#version 300 es\n#define NUMBERS\n${march}`);
    this.upload();
  }

  upload() {
    const { gl, model: volume } = this;
    const { atlas, grid } = volume.about;
    const side = 8 * Math.max(...atlas);
    const most = gl.getParameter(gl.MAX_3D_TEXTURE_SIZE);
    if (side > most) {
      const found = `This device holds 3D textures of ${most} texels a side; the volume needs ${side}.`;
      throw new Error(`${found} Write it with fewer --cells.`);
    }
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const volumeTexture = (unit, inner, outer, size, bytes, filter, type = gl.UNSIGNED_BYTE) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
      gl.texImage3D(gl.TEXTURE_3D, 0, inner, ...size, 0, outer, type, bytes);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, name, filter);
      for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) {
        gl.texParameteri(gl.TEXTURE_3D, name, gl.CLAMP_TO_EDGE);
      }
    };
    const texels = atlas.map((n) => 8 * n);
    volumeTexture(0, gl.RGBA8UI, gl.RGBA_INTEGER, grid.bricks, volume.pages, gl.NEAREST);
    volumeTexture(1, gl.RGBA8, gl.RGBA, texels, volume.matter, gl.LINEAR);
    volumeTexture(2, gl.RG16F, gl.RG, texels, volume.halves(), gl.LINEAR, gl.HALF_FLOAT);
  }

  /** Sets what both programs share. `placing` puts the camera's image on a target of this height. */
  prepare({ program, place }, camera, shown, placing, height) {
    const { gl, model: volume } = this;
    const { grid, atlas, contraction, codes, prior, knowsUnseen } = volume.about;
    gl.useProgram(program);
    const set3 = (name, v) => gl.uniform3f(place(name), ...v);
    const set2 = (name, v) => gl.uniform2f(place(name), ...v);
    const set = (name, v) => gl.uniform1f(place(name), v);
    set3('eye', volume.local(camera.position));
    gl.uniformMatrix3fv(place('axes'), false, camera.axes);
    set2('focal', camera.focal);
    set2('principal', camera.center);
    set3('placing', placing);
    set('canvasHeight', height);
    set3('low', volume.local(shown.crop.min));
    set3('high', volume.local(shown.crop.max));
    set3('origin', volume.local(grid.origin));
    set('edge', grid.edge / volume.unit);
    gl.uniform3i(place('bricks'), ...grid.bricks);
    set3('atlasSize', atlas.map((n) => 8 * n));
    gl.uniform1i(place('norm'), contraction ? (contraction.norm === 'l2' ? 1 : 2) : 0);
    // The prior itself is rounded: at the upper end nothing is removed.
    set('threshold', shown.threshold >= prior ? 2 : volume.shareOf(shown.threshold));
    gl.uniform1i(place('hidesUnseen'), removesUnseen(shown, prior) ? 1 : 0);
    // Where the field does not store what no ray reached, it is what has the prior's U.
    set('unseenFrom', knowsUnseen ? 1.25 : 0.999);
    set2('codes', [codes.low, prior]);
    ['pages', 'matter', 'knowledge'].forEach((name, unit) => gl.uniform1i(place(name), unit));
    this.prepareLayers(place, shown);
  }

  draw(camera, shown) {
    const { gl, canvas } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    this.prepare(this.picture, camera, shown, this.placing(camera, canvas.width, canvas.height), canvas.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Opacity, depth (scene units), log10 U and texture reads of the pixels of a target, from the top left. */
  measure(camera, shown, width, height, placing) {
    const { gl } = this;
    this.target ??= gl.createFramebuffer();
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE4);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    gl.viewport(0, 0, width, height);
    this.prepare(this.numbers, camera, shown, placing ?? this.placing(camera, width, height), height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const bits = new Uint32Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, bits);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteTexture(texture);
    const upwards = new Float32Array(bits.buffer);
    const numbers = new Float32Array(upwards.length);
    for (let row = 0; row < height; row++) {
      numbers.set(upwards.subarray(4 * width * (height - 1 - row), 4 * width * (height - row)), 4 * width * row);
    }
    for (let i = 1; i < numbers.length; i += 4) numbers[i] *= this.model.unit;
    return numbers;
  }

  /** What is under an image point: position, depth, and what the volume holds there; null if nothing is hit. */
  read(camera, shown, x, y) {
    // A target of one pixel, in whose middle the point lies.
    const [opacity, depth] = this.measure(camera, shown, 1, 1, [0.5 - x, 0.5 - y, 1]);
    if (opacity <= 0.5) return null;
    const position = camera.point([x, y], depth);
    return { position, depth, ...this.model.at(position) };
  }
}
