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

/** Return the address of the page with other settings, which have one value, many or none. */
export function addressWith(settings) {
  const url = new URL(location);
  for (const [name, values] of Object.entries(settings)) {
    url.searchParams.delete(name);
    for (const value of [values].flat().filter(Boolean)) url.searchParams.append(name, value);
  }
  return url;
}

/** Return the topic in the address, with the name that the node uses; '' for none. */
export function topicOfAddress() {
  const name = new URL(location).searchParams.get('topic') ?? '';
  return name && name.replace(/^\/?/, '/').replace(/(.)\/(compressed|ffmpeg|foxglove)$/, '$1');
}

/** Keep settings in the address of the page. */
export const keep = (settings) => history.replaceState(null, '', addressWith(settings));

/**
 * Copy a text. The clipboard API would need https.
 *
 * @returns whether the browser allowed it.
 */
export function copyText(text) {
  const { activeElement } = document;
  const field = document.createElement('textarea');
  field.value = text;
  field.readOnly = true; // no keyboard of a phone
  field.style.position = 'fixed';
  document.body.append(field);
  field.select();
  const isCopied = document.execCommand('copy');
  field.remove();
  activeElement?.focus();
  return isCopied;
}
