// A rolling chart of east, north and up. Points come in any order of revision: a later one at the same time replaces.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";

export const WINDOW_S = 120;
const AXES = [
  { label: "east", stroke: "#d1495b" },
  { label: "north", stroke: "#2e86ab" },
  { label: "up", stroke: "#3c8d40" },
] as const;

export interface Block {
  /** UNIX seconds of the first sample. */
  start: number;
  interval: number;
  /** Millimetres, one row an axis. */
  values: [number[], number[], number[]];
  sigmas: [number[], number[], number[]];
}

export class MotionChart {
  private blocks = new Map<number, Block>();
  private plot: uPlot;
  private dirty = false;

  constructor(private readonly host: HTMLElement) {
    const axis = { stroke: "#8a94a6", grid: { stroke: "#8a94a633" }, ticks: { stroke: "#8a94a633" } };
    this.plot = new uPlot(
      {
        width: host.clientWidth || 600,
        height: 200,
        legend: { live: false },
        cursor: { drag: { x: false, y: false } },
        scales: { y: { range: (_u, low, high) => padded(low, high) } },
        axes: [axis, { ...axis, label: "mm", size: 56, labelSize: 18 }],
        series: [{}, ...AXES.map((a) => ({ ...a, width: 1.25, points: { show: false } }))],
      },
      [[], [], [], []],
      host,
    );
    new ResizeObserver(() => this.plot.setSize({ width: host.clientWidth, height: 200 })).observe(host);
  }

  add(block: Block): void {
    this.blocks.set(block.start, block);
    const newest = Math.max(...this.blocks.keys());
    for (const start of this.blocks.keys()) if (start < newest - WINDOW_S) this.blocks.delete(start);
    this.dirty = true;
  }

  /** Draw what has come since the last call; called once a frame by the page. */
  draw(): void {
    if (!this.dirty) return;
    this.dirty = false;
    const times: number[] = [];
    const columns: (number | null)[][] = [[], [], []];
    let end = -Infinity;
    for (const block of [...this.blocks.values()].sort((a, b) => a.start - b.start)) {
      if (block.start - end > 1.5 && times.length) {
        times.push(end); // a gap is drawn as a gap
        for (const column of columns) column.push(null);
      }
      const n = block.values[0].length;
      for (let i = 0; i < n; i++) {
        times.push(block.start + i * block.interval);
        columns.forEach((column, axis) => column.push(block.values[axis as 0 | 1 | 2][i] ?? null));
      }
      end = block.start + n * block.interval;
    }
    this.plot.setData([times, ...columns] as uPlot.AlignedData);
    this.host.dataset.points = String(times.length);
  }
}

function padded(low: number | null, high: number | null): [number, number] {
  if (low === null || high === null) return [-10, 10];
  const margin = Math.max((high - low) * 0.08, 1);
  return [low - margin, high + margin];
}
