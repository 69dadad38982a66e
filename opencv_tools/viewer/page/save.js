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

const KEPT_MS = 10000; // the browser has read the file by then

/**
 * Save a picture in the format of the recorder.
 *
 * @param file answer of the server: the address, or the error why there is no file.
 * @param way how the page shows it.
 * @returns the sentence about it.
 */
export async function savePicture({ address, error }, { turns, isFlipped }) {
  if (error) return error;
  const answer = await fetch(address).catch((err) => new Response(err.message, { status: 503 }));
  if (!answer.ok) return (await answer.text()).trim();
  const name = /filename="([^"]+)"/.exec(answer.headers.get('Content-Disposition') ?? '');
  const link = document.createElement('a');
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name ? name[1] : 'picture';
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
  const way = turns || isFlipped ? ' as the camera has sent it, neither turned nor flipped' : '';
  return `Saved ${link.download}${way}`;
}
