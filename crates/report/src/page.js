// The page: sections of tables, views and plots, and the photo of a picked camera.

const data = JSON.parse(document.getElementById('data').textContent);
document.title = document.querySelector('h1').textContent = data.title;

// ---- The photo of an image with its keypoints ----
const panel = document.getElementById('photo');
const shown = { withPoint: true, without: true };
const picked = { section: null, photos: {}, image: null };

// Two 16-bit numbers a keypoint, as shares of width and height.
function drawKeypoints(context, { keypoints, keypoints_with_point: split }, width, height) {
  const places = new Uint16Array(bytes(keypoints).buffer);
  const scale = [width / 65535, height / 65535];
  // Smaller where there are many, so that they do not hide the photo.
  const crowd = Math.min(Math.max(Math.sqrt(3000 / (places.length / 2)), 0.5), 1);
  const size = (crowd * Math.max(width, height)) / 512;
  for (let pass = 0; pass < 2; pass++) {
    // Those with a point are drawn last, on top.
    const isWithPoint = pass === 1;
    if (!(isWithPoint ? shown.withPoint : shown.without)) continue;
    const [from, to] = isWithPoint ? [0, split] : [split, places.length / 2];
    context.fillStyle = isWithPoint ? '#37ff7a' : '#ff8c3b';
    const side = (isWithPoint ? 3.2 : 2.2) * size;
    for (let k = from; k < to; k++) {
      const [x, y] = [places[2 * k] * scale[0], places[2 * k + 1] * scale[1]];
      context.fillRect(x - side / 2, y - side / 2, side, side);
    }
  }
}
async function drawPhoto(canvas, image, photo) {
  const picture = photo && new Image();
  if (picture) {
    picture.src = `data:image/jpeg;base64,${photo}`;
    await picture.decode();
  }
  // At least 1024 pixels, so that keypoints are finer than the photo.
  canvas.width = 1024;
  canvas.height = Math.round((1024 * image.height) / image.width);
  const context = canvas.getContext('2d', { alpha: false });
  context.fillStyle = '#16181d';
  context.fillRect(0, 0, canvas.width, canvas.height);
  if (picture) context.drawImage(picture, 0, 0, canvas.width, canvas.height);
  drawKeypoints(context, image, canvas.width, canvas.height);
  document.documentElement.dataset.photo = image.name;
}
function showPhoto(section, photos, image) {
  Object.assign(picked, { section, photos, image });
  for (const other of sections) if (other !== section) mark(other, null);
  mark(section, image && image.name);
  panel.hidden = !image;
  panel.replaceChildren();
  if (!image) return;
  const { images } = section.views.find(view => view.images.includes(image));
  const button = (text, title, act) => {
    const made = element('button', { title, 'aria-label': title }, text);
    made.onclick = act;
    return made;
  };
  const step = by => () => {
    const next = (images.indexOf(image) + by + images.length) % images.length;
    showPhoto(section, photos, images[next]);
  };
  const canvas = element('canvas', {
    role: 'img',
    'aria-label': `${image.name} with its keypoints`,
  });
  const photo = photos[image.name];
  const box = (key, kind, text) => {
    const input = element('input', { type: 'checkbox' });
    input.checked = shown[key];
    input.onchange = () => {
      shown[key] = input.checked;
      drawPhoto(canvas, image, photo);
    };
    return element('label', { class: kind }, input, text);
  };
  const { num_keypoints: all, num_with_point: withPoint } = image;
  const drawn = bytes(image.keypoints).length / 4;
  panel.append(
    element(
      'div',
      { class: 'tools' },
      element('strong', {}, image.name),
      button('◀', 'previous image', step(-1)),
      button('▶', 'next image', step(1)),
      button('look through', 'look through this camera', () => lookThrough(section, image)),
      button('✕', 'close', () => showPhoto(section, photos, null)),
    ),
    canvas,
    element(
      'p',
      { class: 'tools' },
      box('withPoint', 'with-point', `${withPoint} keypoints with a point`),
      box('without', 'without-point', `${all - withPoint} without`),
      ...(drawn < all ? [element('span', { class: 'note' }, `${drawn} of them drawn`)] : []),
    ),
    ...(photo ? [] : [element('p', { class: 'note' }, 'The page has no photo of this image.')]),
  );
  drawPhoto(canvas, image, photo);
}
addEventListener('keydown', event => {
  if (event.key === 'Escape' && picked.image) showPhoto(picked.section, {}, null);
});

// ---- Sections ----
function plotsOf(model) {
  const plots = element('div', { class: 'plots' });
  const add = (title, content) => plots.append(titled(title, content));
  if (model.trajectory) {
    const { path_length, horizontal, vertical } = model.trajectory;
    add(
      'Position error along the drive: horizontal (blue), vertical (red), in metres',
      lines([path_length, path_length], [horizontal, vertical], 'm driven'),
    );
  }
  const [places, distances] = model.cloud_errors;
  if (places.length)
    add(
      'Mean distance of the dense cloud to the scan along the drive, in metres',
      lines([places], [distances], 'm driven', [0]),
    );
  add(
    'Reprojection errors of the observations; the last bin has all larger ones',
    histogram(model.errors, 'px', false),
  );
  add(
    'Track lengths of the points; the last bin has all longer ones',
    histogram(model.track_lengths, 'images', true),
  );
  for (const rig of model.rigs) {
    const [what, unit] = rig.has_times ? ['time', 's'] : ['number', 'image number'];
    add(
      `Distance ${rig.cameras[0]} – ${rig.cameras[1]} over ${what} (${model.unit}), ` +
        (rig.has_clock ? 'at the times of the clock' : `images nearest in ${what}`),
      lines([rig.times_s], [rig.baselines], unit),
    );
    const times = rig.rotations_deg.map(() => rig.times_s);
    add(
      'Deviation of the relative rotation from its mean (degrees; x blue, y red, z green)',
      lines(times, rig.rotations_deg, unit),
    );
  }
  add(
    'Covisibility: common points of two images (in order of their names)',
    matrix(model.covisibility),
  );
  if (model.stages.length) add('Time of the stages', bars(model.stages));
  return plots;
}

// What is shown of a model: views, and plots below them if it is alone.
function column(section, model, isAlone) {
  const photos = model.photos === null ? {} : data.photos[model.photos];
  const place = model => {
    if (!renderer) return element('p', {}, 'The 3D view needs a browser with WebGL.');
    return makeView(section, model, photos, image => showPhoto(section, photos, image)).place;
  };
  const isPart = model.points_shown < model.num_points;
  const shown = isPart ? `, ${model.points_shown} of them shown` : '';
  const dense = model.dense;
  const picture = ([name, png]) =>
    element(
      'div',
      {},
      element('h3', {}, name),
      element('img', { src: `data:image/png;base64,${png}`, alt: `depth map of ${name}` }),
    );
  const denseView = () => [
    element(isAlone ? 'h2' : 'h3', {}, 'Dense cloud'),
    place({ ...model, ...dense, name: 'the dense cloud', trajectory: null }),
    element(
      'p',
      { class: 'note' },
      `${dense.num_points} points, ${dense.points_shown} of them shown. Depth maps: near` +
        ' is light, black has no depth.',
    ),
    element('div', { class: 'depths' }, ...dense.pictures.map(picture)),
  ];
  const green = model.trajectory ? '. The green line is the true trajectory' : '';
  const main = [
    place(model),
    element(
      'p',
      { class: 'note' },
      `${model.num_images} images, ${model.num_points} points${shown}${green}.`,
    ),
    ...(dense ? denseView() : []),
  ];
  if (isAlone) return { main, plots: plotsOf(model) };
  const plots = element('details', {}, element('summary', {}, 'Plots'), plotsOf(model));
  return { main: [element('h3', {}, model.name), ...main, plots], plots: null };
}

// Buttons and choices for the views of a section.
function tools(section) {
  const button = (text, act) => {
    const made = element('button', {}, text);
    made.onclick = act;
    return made;
  };
  const cameras = element('input', { type: 'checkbox' });
  cameras.checked = true;
  cameras.onchange = () => {
    for (const view of section.views) view.frusta.visible = cameras.checked;
    redraw(section);
  };
  const size = element('input', { type: 'range', min: -2, max: 3, step: 0.25, value: 0 });
  size.oninput = () => {
    section.pointSize = 2 ** size.value;
    redraw(section);
  };
  const { images, photos } = section.views[0];
  const names = images.map(({ name }) => element('option', {}, name));
  const none = element('option', { value: '' }, 'photo of …');
  const list = element('select', { 'aria-label': 'photo of a camera' }, none, ...names);
  list.onchange = () => {
    const image = images.find(({ name }) => name === list.value);
    list.value = '';
    showPhoto(section, photos, image);
  };
  return element(
    'div',
    { class: 'tools' },
    button('reset view', () => reset(section)),
    button('from above', () => fromAbove(section)),
    element('label', {}, cameras, 'cameras'),
    element('label', {}, 'point size', size),
    list,
  );
}

startRenderer();
for (const { heading, note, alerts, tables, models } of data.sections) {
  const section = renderer && makeSection();
  const isAlone = models.length === 1;
  const columns = models.map(model => column(section, model, isAlone));
  const compared = models.filter(model => model.trajectory);
  const help =
    'Drag to rotate, shift and drag to pan, use the wheel to zoom (with two fingers on a touch' +
    ' screen), double-click for the view from above, click a camera for its photo. With the' +
    ' keyboard: arrows, plus, minus, Home' +
    (models.length > 1 ? '. These views move together.' : '.');
  const shownTables = tables.filter(one => one.rows.length).map(table);
  const views = [
    ...(section && section.views.length ? [tools(section)] : []),
    ...(models.length ? [element('p', { class: 'note' }, help)] : []),
  ];
  const place = element('div', { class: isAlone ? 'alone' : 'models' });
  place.style.setProperty('--columns', Math.max(1, Math.min(models.length, 3)));
  if (isAlone) {
    const side = element('div', { class: 'facts' }, ...shownTables);
    place.append(element('div', {}, ...views, ...columns[0].main), side);
  } else place.append(...columns.map(({ main }) => element('section', {}, ...main)));
  document.getElementById('sections').append(
    ...(heading ? [element('h2', {}, heading)] : []),
    ...(note ? [element('p', { class: 'verdict' }, note)] : []),
    ...(alerts.length
      ? [element('ul', { class: 'alerts' }, ...alerts.map(text => element('li', {}, text)))]
      : []),
    ...(compared.length ? [comparison(compared)] : []),
    ...(isAlone ? [] : [...shownTables, ...views]),
    place,
    ...(isAlone && !heading ? [element('h2', {}, 'Plots')] : []),
    ...(isAlone ? [columns[0].plots] : []),
  );
  if (section && section.views.length) reset(section);
}
for (const [name, text] of data.files) {
  const whole = element('pre', { tabindex: 0 }, text);
  const unfolded = element('details', {}, element('summary', {}, name), whole);
  document.getElementById('files').append(unfolded);
}
