// Copyright 2026 opencv_tools maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

const GAP = 16; // pixels between tiles
const CAPTION = 60; // pixels of the texts below a picture
const LEAST_TILE = 280; // width in pixels

/**
 * Return the columns and the width of tiles that are all on the screen, as large as possible.
 *
 * If the pictures were too small, the tiles fill the width, and the page scrolls.
 */
function fit(count, width, height, caption, ratio, least) {
  let best = { score: 0 };
  for (let columns = 1; columns <= count; columns += 1) {
    const rows = Math.ceil(count / columns);
    const tile = Math.min((width + GAP) / columns - GAP,
      ((height + GAP) / rows - GAP - caption) * ratio);
    const score = tile * Math.sqrt(count / (rows * columns)); // few gaps in the last row
    if (tile >= least && score > best.score) best = { score, columns, tile };
  }
  if (best.score) return best;
  const most = Math.floor((width + GAP) / (least + GAP));
  const columns = Math.max(1, Math.min(count, most));
  return { columns, tile: (width + GAP) / columns - GAP };
}

/**
 * Arrange the tiles.
 *
 * @param count number of tiles.
 * @param ratio width of a picture to its height.
 * @param one tile that is shown alone, or beside another one; undefined for all.
 * @param size least width of a tile in pixels, which may be off the screen; 0 for no matter.
 */
export function arrange(count, ratio, one, size) {
  const cameras = document.getElementById('cameras');
  const below = document.querySelector('footer').offsetHeight
    + document.getElementById('more').offsetHeight + GAP;
  const height = innerHeight - document.getElementById('content').offsetTop - GAP - below;
  // Only the texts of a single picture are off an upright screen.
  const scrolls = count === 1 && innerWidth < innerHeight && cameras.clientWidth / ratio < height;
  const caption = !one ? CAPTION : scrolls ? 0 : one.element.offsetHeight - one.link.offsetHeight;
  const { columns, tile } = fit(count, cameras.clientWidth, size && !one ? 0 : height, caption,
    ratio, one && count === 1 ? 1 : (!one && size) || LEAST_TILE);
  cameras.style.setProperty('--ratio', ratio);
  cameras.style.setProperty('--columns', columns);
  cameras.style.setProperty('--tile', `${tile}px`);
}
