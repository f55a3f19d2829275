/* What Python writes for the pages: leaderboard/site/index_data.py and scene_data.py. For `make site-check` alone. */

interface Route {
  parts: string[];
  params: URLSearchParams;
}
interface Page {
  title: string;
  nodes: (Node | string | null)[];
  /** What an address asks to be scrolled to. */
  target?: Element;
  ready?: () => void;
  destroy?: () => void;
}
type PageMaker = (here: Route) => Page;
/** Values, or values with what is shown. */
type Choices = (string | [string, string])[];
/** By the text of a row and its cells. */
type RowFilter = (text: string, row: string[], table: TableData) => boolean;
/** `fits` chooses other tables than those of the tab, `also` filters what stands beside them. */
interface TabOptions {
  tab: string;
  title: string;
  lead: string;
  link?: string;
  target?: Element;
  first?: Page["nodes"];
  last?: Page["nodes"];
  choices?: (Node | null)[];
  fits?: (table: TableData) => boolean;
  also?: () => void;
}

/** Facts behind a number; `record` is a place among the origins of the index. */
interface CellFacts {
  n?: number;
  low?: number | string;
  high?: number | string;
  record: number;
}
interface TableData {
  id: string;
  title: string;
  columns: string[];
  textColumns: number;
  rows: string[][];
  groups: [string, number][];
  cells: (CellFacts | null)[][] | null;
  notes: string[];
  /** Classes of shaded cells. */
  heat?: (string | null)[][] | null;
  /** First row that stands apart, and the column by which rows are ordered. */
  apart?: number;
  sorted?: number | null;
  data?: string;
  group?: string;
  judge?: string | null;
  ofPlanner?: boolean;
}
interface FigureData {
  data: string;
  tab: string;
  title: string;
  path: string;
  dark: string;
  size: [number, number];
}
/** A term and a text; `code` where it is a hash. */
type Fact = [string, string, string?];
interface ModelData {
  name: string;
  shown: string;
  lead: string[];
  data: string[];
  facts: Fact[];
  runs: { title: string; facts: Fact[] }[];
}
interface SceneData {
  key: string;
  data: string;
  split: string;
  scene: string;
  manoeuvre: string | null;
  text: string;
  hasSheet: boolean;
  thumb: string | null;
  thumbDark: string | null;
  rounds: string | null;
  marks: Record<string, Record<string, string>>;
  tally: Record<string, string>;
  counts: Record<string, [number, number]>;
  samples: Record<string, [number, string]>;
  judged: [string, string, string][];
  order: Record<string, number>;
  pair: string[];
}
interface DriveData {
  key: string | null;
  scene: string;
  planner: string;
  measured: string;
  outcome: string;
  note: string;
}
interface Filter {
  name: string;
  label: string;
  any: string;
  choices: Choices;
}
interface SiteIndex {
  title: string;
  /** By mark: sign, kind, words on a scene, on one plan, in a sentence. */
  legend: Record<string, [string, string, string, string, string]>;
  abbreviations: Record<string, string>;
  protocols: string[];
  tables: TableData[];
  /** Tab by group of tables, those of earlier sites among them. */
  tabs: Record<string, string>;
  mainTables: TableData[];
  /** Of extensions. */
  pages: { tab: string; name: string; path: string }[];
  figures: FigureData[];
  models: ModelData[];
  scenes: SceneData[];
  attempts: Record<string, string>[];
  attemptFilters: Filter[];
  attemptTally: [string, number][];
  drives: DriveData[];
  sceneFilters: Filter[];
  sceneOrders: [string, string][];
  starts: { data: string; lead: string; splits: string; scene: string | null; compare: [string, string] | null }[];
  origins: number[][];
  words: string[];
}
/** What a scene's page says; a part is a text, or a text and what it links. */
interface ScenePage {
  facts: [string, (string | [string, string])[][]][];
  tables: TableData[];
}

interface Box {
  x: number;
  y: number;
  yaw: number;
  length: number;
  width: number;
}
interface Body {
  length: number;
  width: number;
  ahead: number;
}
interface Agent {
  id: string;
  kind: string;
  adversary: boolean;
  letter: string;
  length: number;
  width: number;
  first: number;
  count: number;
  x: Float64Array;
  y: Float64Array;
  yaw: Float64Array;
}
interface Plan {
  path: Float64Array;
  yaw: Float64Array;
  boxes: Box[];
  modes: Float64Array[];
  forecasts: (Box & { path: Float64Array | null })[];
  cause?: string;
  reason?: string;
  hit?: number;
  l2?: string[];
}
/** `marks` within 1, 2 and 3 s, the last one as `mark`; seconds to the first contact, and the same in words. */
interface Verdict {
  marks: string;
  mark: string;
  counted: boolean;
  contact: number | null;
  words: string;
}
interface Planner {
  name: string;
  shown: string;
  first: (number | null)[];
  outcome?: [string, string];
  plan: (sample: number) => Plan | null;
  failed: (sample: number) => string | undefined;
  verdict: (sample: number, protocol: number) => Verdict | null;
}
interface Scene {
  key: string;
  scene: string;
  manoeuvre: string | null;
  description: string;
  hasSheet: boolean;
  adversarial: boolean;
  driven: boolean;
  page: ScenePage | null;
  frames: number[];
  samples: { frame: number; t: number; command: number | null }[];
  sampleOf: Int32Array;
  body: Body;
  ego: (Body & { x: Float64Array; y: Float64Array; yaw: Float64Array }) | null;
  agents: Agent[];
  ground: { areas: Record<string, Path2D>; dividers: [string, Path2D][] };
  recorded: Float64Array[];
  recordedPath: Float64Array | null;
  contact: { t: number; x: number; y: number } | null;
  /** Of a drive in a window: when it begins; kind, style, title and text of each element of the strip. */
  opens?: number;
  strip?: string[][];
  considered: { t: number; did: string; shares: number[]; paths: Float64Array[]; chosen: Float64Array | null }[];
  cameras: { name: string; left: number; top: number; width: number; height: number }[];
  pictures: number[];
  media: string;
  edges: Record<string, Record<string, number[]>>;
  protocols: string[];
  models: Planner[];
  shown: string[][];
  closest: number | null;
  apart: ([string, string, string] | null)[][][];
}
interface Style {
  place: number;
  colour: string;
  dash: number[];
  shape: string;
}
interface ViewState {
  frame: number;
  chosen: Planner[];
  protocol: string | null;
  show: Record<string, boolean>;
}
interface PlayerOptions {
  compare?: boolean;
  models?: string[];
  t?: number;
  protocol?: string;
  camera?: string;
  onState?: (state: { t: number; models: string[]; protocol: string | null; camera: string | null }) => void;
}

interface Window {
  CHALLENGER: SiteIndex;
  CHALLENGER_SCENES: Record<string, any>;
  CHALLENGER_READY: boolean;
}
