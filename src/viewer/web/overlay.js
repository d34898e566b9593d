// Frusta of the training cameras, drawn over the picture.

/** Draws the frusta; `place` takes an image point of the moving camera to the canvas. */
function drawFrusta(canvas, camera, cameras, current, place, length) {
  const pen = canvas.getContext('2d');
  pen.clearRect(0, 0, canvas.width, canvas.height);
  cameras.forEach((other, k) => {
    const corner = (x, y) => {
      const seen = [(x - other.center[0]) / other.focal[0], -(y - other.center[1]) / other.focal[1], -1];
      return add(other.position, scale(times(other.axes, seen), length));
    };
    const [w, h] = other.resolution;
    const corners = [corner(0, 0), corner(w, 0), corner(w, h), corner(0, h)];
    const points = [other.position, ...corners].map((x) => camera.project(x));
    if (points.some((p) => p === null)) return;
    const [eye, ...image] = points.map(place);
    pen.strokeStyle = k === current ? '#ff8000' : 'rgba(20, 90, 160, 0.55)';
    pen.lineWidth = k === current ? 2 : 1;
    pen.beginPath();
    for (const p of image) {
      pen.moveTo(...eye);
      pen.lineTo(...p);
    }
    image.forEach((p, i) => (i === 0 ? pen.moveTo(...p) : pen.lineTo(...p)));
    pen.closePath();
    pen.stroke();
  });
}
