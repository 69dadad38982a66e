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

// Messages between the pages and img_viewer as JSON. tsc checks the pages against them; the tests
// check each message of the server that they read, see test/support/page_messages.py.

/** A node and the page of its topics. */
export interface Hello {
  host: string;
  control: boolean;
  widths: number[];
  download: boolean;
  video: string;
  token: string;
}

export interface Topic {
  id: number;
  name: string;
  transports: string[];
  nodes: string[];
  publishers: number;
}

/** The last picture that was sent, or the last packet of video. */
export interface Sent {
  width: number;
  height: number;
  rate: number;
  bytes: number;
  quality?: number;
  passed_through?: boolean;
  video?: string;
  skipped?: number;
  slow?: boolean;
}

export interface Status {
  id: number;
  name: string;
  width: number;
  height: number;
  encoding: string;
  unit: string;
  rate: number;
  frames: number;
  broken: number;
  encodings: number;
  quiet: number | null;
  restarted: number | null;
  lost: number;
  reason: string;
  range: (number | null)[] | null;
  sent: Sent | null;
  link: number | null;
  overlay: string;
}

/** Histogram, or profile of a line. */
export interface Chart {
  topic?: string;
  picture?: number;
  names?: string[];
  curves?: (number | null)[][];
  low?: number | null;
  high?: number | null;
  ends?: string;
  over?: number;
  under?: number;
  missing?: number;
  lacking?: string;
  least?: [string, number, number];
  most?: [string, number, number];
  error?: string;
}

/** Cells with over-exposed pixels, as bits in base64, row by row. */
export interface Exposed {
  topic: string;
  picture: number;
  bits?: string;
  columns?: number;
  step?: number;
  place?: number[];
  error?: string;
}

export interface Pixel {
  topic: string;
  picture: number;
  text?: string;
  error?: string;
}

/** Boxes of a picture: x, y, width, height, angle and text. */
export interface Boxes {
  topic: string;
  picture: number;
  list: [number, number, number, number, number, string][];
}

/** Principal point and undistorted view of a camera. */
export interface Camera {
  topic: string;
  center: number[] | null;
  outline: (number[] | null)[];
}

export interface StepAnswer {
  topic: string;
  text?: string;
  error?: string;
}

export interface FileAnswer {
  topic: string;
  address?: string;
  error?: string;
}

export interface Refusal {
  topic: string;
  reason: string;
}

export interface Nodes {
  cameras: string[];
  recorders: string[];
}

export interface Parameter {
  name: string;
  type: string;
  value: any;
  minimum: number | null;
  maximum: number | null;
  step: number | null;
  choices: [any, string][];
  description: string;
  read_only: boolean;
}

/** What became of a request to another node; `node` is what the page has written. */
export interface Done {
  ok?: boolean;
  message?: string;
  node?: any;
  name?: any;
  value?: any;
  parameters?: Parameter[];
  capture?: boolean;
}

/** Account of a recording. */
export interface Account {
  phase: string;
  keeps?: boolean;
  folder?: string;
  topics?: string[];
  since?: number;
  seconds?: number;
  frames?: number;
  dropped?: number;
  lost?: number;
  failed?: number;
  bytes?: number;
  left?: number | null;
  name?: string;
  problem?: string;
}

/** Message of the server to the page of the cameras. */
export interface Answer {
  hello?: Hello;
  pong?: any;
  now?: number;
  topics?: Topic[];
  more?: number;
  robot?: boolean;
  detections?: string[];
  nodes?: Nodes;
  recording?: Account;
  status?: Status[];
  error?: string;
  topic?: string;
  refused?: Refusal;
  pixel?: Pixel;
  profile?: Chart;
  histogram?: Chart;
  exposed?: Exposed;
  boxes?: Boxes;
  camera?: Camera;
  step?: StepAnswer;
  file?: FileAnswer;
  parameters?: Done;
  set?: Done;
  capture?: Done;
  save?: Done;
  record?: Done;
  keep?: Done;
}

/** Request for pictures of a topic. */
export interface Subscribe {
  subscribe?: string;
  width?: number;
  quality?: number;
  rate?: number;
  fixed?: boolean;
  range?: number[];
  video?: boolean;
  region?: number[] | null;
  colors?: string;
  looks?: boolean;
  held?: boolean;
  searched?: boolean;
}

/** Message of the page of the cameras; the first word says which. */
export interface Request extends Subscribe {
  unsubscribe?: string;
  got?: number;
  busy?: number;
  ping?: number;
  codecs?: string[];
  key?: string;
  file?: string;
  pixel?: string;
  profile?: string;
  histogram?: string;
  exposed?: string;
  picture?: number;
  at?: number[];
  from?: number[];
  to?: number[];
  overlays?: string;
  boxes?: string;
  camera?: boolean;
  step?: string;
  by?: number;
  beside?: string;
  parameters?: string;
  set?: string;
  name?: string;
  value?: any;
  capture?: string;
  on?: boolean;
  save?: string;
  record?: number[] | boolean;
  since?: number;
  keep?: number[];
}

/** A view of a calibration; the last three are of the views that were solved. */
export interface SessionView {
  number: number;
  place: (number | null)[];
  extent: number;
  error?: number | null;
  tilt?: number | null;
  dropped?: boolean;
}

export interface Lens {
  name: string;
  value: number | null;
  deviation: number | null;
}

/** What a calibration has found. */
export interface Solution {
  number: number;
  model: string;
  views: number;
  rms: number | null;
  held_out: number | null;
  bend_mm: number | null;
  lens: Lens[];
  distortion: (number | null)[];
  cells: (number | null)[][];
  verdict: string;
  reasons: string[];
}

/** How many views, and which part of the cells, are enough. */
export interface Wanted {
  views: number;
  cells: number;
}

/** State of a calibration. */
export interface Session {
  board: string;
  note: string;
  size: number[] | null;
  hint: string;
  notice: string;
  progress: number;
  wanted: Wanted;
  views: SessionView[];
  cells: number[][];
  tilts: Record<string, number>;
  result: Solution | null;
  stale: boolean;
  paused: boolean;
  topic: string;
  busy: string;
  restorable: boolean;
}

export interface SessionHello {
  host: string;
  topic: string;
  models: string[];
  boards: string[];
}

/** Corners of the board in a frame, by its stamp and number, and what the search says. */
export interface Seen {
  frame: string;
  corners: number[][];
  capture: string;
}

/** Message of the server to the page of a calibration. */
export interface SessionAnswer {
  hello?: SessionHello;
  state?: Session;
  seen?: Seen;
  error?: string;
  pong?: any;
  now?: number;
}

/** Message of the page of a calibration. */
export interface SessionRequest {
  ping?: number;
  board?: string;
  delete?: number;
  take?: boolean;
  discard?: boolean;
  resume?: boolean;
  solve?: string;
  save?: number;
  restore?: boolean;
}

/** State of the live robot. */
export interface RobotState {
  version: number;
  error: string;
  late: boolean;
  age: number | null;
  rate: number;
  notes: string[];
}

/** Message of the server to the page of the robot. */
export interface RobotAnswer {
  hello?: Record<string, any>;
  pong?: any;
  now?: number;
  state?: RobotState;
  version?: number;
  positions?: [number, number[]][];
  error?: string;
}

/** Message of the page of the robot. */
export interface RobotRequest {
  ping?: number;
  watch?: boolean;
  got?: number;
}
