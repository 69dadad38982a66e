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

const RECTIFIED = 'image_rect'; // name of image_proc, which img_publisher uses as well
const RAW = /\/image(_raw)?$/; // names of images that a node of its own rectifies

/** Return whether a topic has rectified pictures by its name, such as image_rect_color. */
export const isRectified = (name) => name.slice(name.lastIndexOf('/') + 1).startsWith(RECTIFIED);

/**
 * Return the topic with the rectified pictures of a camera; '' if there is none.
 *
 * @param name topic with the raw pictures.
 * @param tiles tiles by topic.
 */
export function rectifiedOf(name, tiles) {
  const other = `${name.slice(0, name.lastIndexOf('/'))}/${RECTIFIED}`;
  const nodes = tiles.get(other)?.topic?.nodes;
  if (other === name || !nodes) return '';
  const own = tiles.get(name)?.topic?.nodes ?? [];
  return RAW.test(name) || nodes.some((node) => own.includes(node)) ? other : '';
}
