// Injected into report.html by page.rs. `problems` is filled by a script before all others.
addEventListener('load', async () => {
  // In frames: with the browser's virtual time, seconds pass between two frames.
  const wait = async condition => {
    for (let k = 0; k < 200 && !condition(); k++) await new Promise(requestAnimationFrame);
    return condition();
  };
  const found = {};
  const root = document.documentElement.dataset;
  found.hasDrawn = await wait(() => root.points > 0);
  found.points = Number(root.points);
  const view = sections[0].views[0];
  // Pixels that are not background.
  const pixels = canvas => {
    const context = canvas.getContext('2d');
    return new Uint32Array(context.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  };
  const background = 0xff1d1816;
  found.lit = pixels(view.canvas).filter(pixel => pixel !== background).length;
  found.red = pixels(view.canvas).filter(pixel => (pixel & 0xffffff) === 0x5e6bff).length;

  // A click on the centre of a camera.
  const image = view.images[2];
  prepare(view);
  const [x, y] = onCanvas(view, image.corners, 0);
  const box = view.canvas.getBoundingClientRect();
  const at = { clientX: box.left + x, clientY: box.top + y, bubbles: true, cancelable: true };
  found.hoveredNothing = imageAt(view, { clientX: box.left + 2, clientY: box.top + 2 }) === null;
  view.canvas.dispatchEvent(new MouseEvent('click', at));
  await wait(() => root.photo);
  found.image = image.name;
  found.photo = root.photo;
  const panel = document.getElementById('photo');
  found.isOpen = !panel.hidden;
  found.text = panel.textContent;
  const colours = pixels(panel.querySelector('canvas'));
  found.colours = new Set(colours).size;
  found.green = colours.filter(pixel => pixel === 0xff7aff37).length;
  found.orange = colours.filter(pixel => pixel === 0xff3b8cff).length;
  found.isMarked = view.picked.visible;

  // The wheel moves the camera; at rest all points are drawn.
  const distance = () => view.section.camera.position.length();
  const before = distance();
  view.canvas.dispatchEvent(new WheelEvent('wheel', { ...at, deltaY: -200 }));
  found.hasMoved = await wait(() => distance() < 0.95 * before);
  motion.limit = 10;
  redraw(view.section, true);
  found.fewest = await wait(() => view.drawn === 10);
  found.all = await wait(() => view.drawn === view.points.count);
  lookThrough(view.section, image);
  const { position } = view.section.camera;
  found.eye = position.distanceTo(new THREE.Vector3(...image.corners.subarray(0, 3)));

  // Labels of all plots, and of axes that have little to tell apart.
  const axes = [...document.querySelectorAll('svg')].flatMap(svg =>
    ['x', 'y'].map(axis =>
      [...svg.querySelectorAll(`[data-axis=${axis}]`)].map(label => label.textContent),
    ),
  );
  found.axes = axes.filter(labels => labels.length > 0);
  found.ticks = [
    [0, 0],
    [5, 5],
    [0, 1e-12],
    [0.5340001, 0.5340003],
    [-2e-7, 1e-7],
    [1700000000, 1700000060],
    [1700000000.1, 1700000000.2],
    [-123456.7, 987654.3],
    [0, 3e9],
    [0.49999, 0.50001],
    [99.99, 100.01],
    [-1, -0.999],
    [2, 31],
  ].map(bounds => ticks(widened(bounds)).labels);
  // By keyboard: the view turns, and every plot, picture and control has a name.
  const yaw = () => Math.atan2(view.section.camera.position.y, view.section.camera.position.x);
  reset(view.section);
  const [from, far] = [yaw(), distance()];
  const press = key => view.canvas.dispatchEvent(new KeyboardEvent('keydown', { key }));
  press('ArrowRight');
  found.turns = Math.abs(yaw() - from - 0.1) < 1e-6;
  press('+');
  found.zooms = Math.abs(distance() / far - 0.9) < 1e-6;
  const named = element =>
    element.getAttribute('aria-label') || element.textContent.trim() || element.closest('label');
  // The name of a button has its words, and headings leave out no level.
  found.misnamed = [...document.querySelectorAll('button[aria-label]')]
    .filter(({ textContent }) => /[a-z]/.test(textContent))
    .filter(button => !button.getAttribute('aria-label').includes(button.textContent))
    .map(({ outerHTML }) => outerHTML);
  const headings = [...document.querySelectorAll('h1, h2, h3')];
  const levels = [0, ...headings.map(({ tagName }) => Number(tagName[1]))];
  found.skipping = headings
    .filter((_, k) => levels[k + 1] > levels[k] + 1)
    .map(({ outerHTML }) => outerHTML);
  found.unnamed = [...document.querySelectorAll('canvas, .plots svg, button, select, input, th')]
    .filter(element => !named(element))
    .map(element => element.outerHTML.slice(0, 80));
  const scene = document.querySelector('.scene');
  found.legend = scene.querySelector('.legend').textContent;
  found.bar = scene.querySelector('.bar').textContent;
  found.problems = problems;
  console.info(`RESULT ${JSON.stringify(found)}`);
});
