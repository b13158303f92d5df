// Canvases whose pixels are those of the screen.

/** Fit a canvas to its size on the page; draw in CSS pixels. Whether its size has changed. */
export function fit(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth, clientHeight } = canvas;
  const width = Math.max(1, Math.round(clientWidth * ratio));
  const height = Math.max(1, Math.round(clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}

/** The context, scaled to CSS pixels, with nothing drawn. */
export function begin(canvas) {
  const context = canvas.getContext("2d");
  const ratio = window.devicePixelRatio || 1;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return context;
}

/** Call resized() now and whenever the size of an element changes. */
export function watchSize(element, resized) {
  new ResizeObserver(() => resized()).observe(element);
  resized();
}
