// A camera that is moved by hand: about a point that it looks at.

class Orbit {
  /** Starts at one of the cameras, about a point at `distance` in front of it. */
  constructor(camera, up, distance) {
    this.up = up;
    this.jump(camera, distance);
  }

  jump(camera, distance) {
    Object.assign(this, {
      position: [...camera.position],
      axes: [...camera.axes],
      focal: [...camera.focal],
      center: [...camera.center],
      resolution: [...camera.resolution],
      distance,
    });
  }

  /** The point about which it turns. */
  target() {
    return sub(this.position, scale(column(this.axes, 2), this.distance));
  }

  /** Turns about the target: around the upright axis, and over it. */
  orbit(yaw, pitch) {
    const target = this.target();
    const right = column(this.axes, 0);
    const turn = (v) => turned(turned(v, right, pitch), this.up, yaw);
    this.axes = [0, 1, 2].flatMap((k) => turn(column(this.axes, k)));
    this.position = add(target, scale(column(this.axes, 2), this.distance));
  }

  /** Moves sideways and up, in pixels of the camera's image at the distance of the target. */
  pan(x, y) {
    const length = this.distance / this.focal[0];
    const shift = add(scale(column(this.axes, 0), -x * length), scale(column(this.axes, 1), y * length));
    this.position = add(this.position, shift);
  }

  /** Goes nearer to the target (factor below 1) or away from it. */
  zoom(factor) {
    const target = this.target();
    this.distance *= factor;
    this.position = add(target, scale(column(this.axes, 2), this.distance));
  }

  /** The image point of a scene point, and its depth; null behind the camera. */
  project(x) {
    const p = sub(x, this.position);
    const [right, up, back] = [0, 1, 2].map((k) => dot(column(this.axes, k), p));
    if (back >= -1e-9) return null;
    return [this.center[0] - (this.focal[0] * right) / back, this.center[1] + (this.focal[1] * up) / back];
  }

  /** Unit direction through an image point. */
  direction([x, y]) {
    const seen = [(x - this.center[0]) / this.focal[0], -(y - this.center[1]) / this.focal[1], -1];
    return times(this.axes, unit(seen));
  }
}

/** The direction that is up in most images. */
function upright(cameras) {
  const sum = cameras.reduce((s, camera) => add(s, column(camera.axes, 1)), [0, 0, 0]);
  return norm(sum) > 0.05 * cameras.length ? unit(sum) : [0, 0, 1];
}
