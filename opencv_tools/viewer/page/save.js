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
 * Save the newest picture of a topic in the format of the recorder.
 *
 * @returns the name of the file.
 * @throws an error with the sentence of the server.
 */
export async function savePicture(topic) {
  const answer = await fetch(`/snapshot?topic=${encodeURIComponent(topic)}&format=original`);
  if (!answer.ok) throw new Error((await answer.text()).trim());
  const file = /filename="([^"]+)"/.exec(answer.headers.get('Content-Disposition') ?? '');
  const link = document.createElement('a');
  link.href = URL.createObjectURL(await answer.blob());
  link.download = file ? file[1] : 'picture';
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
  return link.download;
}
