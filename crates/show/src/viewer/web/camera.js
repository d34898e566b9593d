// A camera that is moved by hand: about a point that it looks at.

/** Smallest angle between the line of sight and the upright axis while the horizon is kept level, radians. */
const POLE = 0.02;

class Orbit {
  /** Starts at one of the cameras, about a point at `distance` in front of it. */
  constructor(camera, up, distance) {
    this.up = up;
    this.isLevel = true;
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

  /** Looks at a point from `distance` against the direction `back`, with the horizon level if it is kept so. */
  look(target, back, distance) {
    const up = this.isLevel ? this.up : column(this.axes, 1);
    const side = cross(up, back);
    const right = norm(side) > 0.1 * POLE ? unit(side) : column(this.axes, 0);
    this.axes = [...right, ...cross(back, right), ...back];
    this.distance = distance;
    this.position = add(target, scale(back, distance));
  }

  /** Turns about the target: around the upright axis, and over it; without a level horizon around its own axes. */
  orbit(yaw, pitch) {
    const target = this.target();
    const [right, above, back] = [0, 1, 2].map((k) => column(this.axes, k));
    if (this.isLevel) {
      const side = unit(cross(this.up, back));
      const before = Math.acos(Math.min(Math.max(dot(this.up, back), -1), 1));
      const after = Math.min(Math.max(before + pitch, POLE), Math.PI - POLE);
      this.look(target, unit(turned(turned(back, side, after - before), this.up, yaw)), this.distance);
    } else {
      this.axes = [right, above, back].flatMap((v) => turned(turned(v, right, pitch), above, yaw));
      this.position = add(target, scale(column(this.axes, 2), this.distance));
    }
  }

  /** Moves sideways and up, in pixels of the camera's image at the distance of the target. */
  pan(x, y) {
    this.move(-x / this.focal[0], y / this.focal[0], 0);
  }

  /** Moves to the right, up and forward together with the target, in parts of its distance. */
  move(...parts) {
    const [right, up, forward] = parts.map((part) => part * this.distance);
    this.position = add(this.position, times(this.axes, [right, up, -forward]));
  }

  /** Goes nearer to the target (factor below 1) or away from it. */
  zoom(factor) {
    const target = this.target();
    this.distance *= factor;
    this.position = add(target, scale(column(this.axes, 2), this.distance));
  }

  /** The image point of a scene point; null behind the camera. */
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

  /** The scene point at a distance along the ray through an image point. */
  point(at, distance) {
    return add(this.position, scale(this.direction(at), distance));
  }
}

/** The pose that is `part` of the way from one to another. */
function between(from, to, part) {
  const mix = (a, b) => add(scale(a, 1 - part), scale(b, part));
  const back = unit(mix(column(from.axes, 2), column(to.axes, 2)));
  const right = unit(cross(mix(column(from.axes, 1), column(to.axes, 1)), back));
  return { position: mix(from.position, to.position), axes: [...right, ...cross(back, right), ...back] };
}
