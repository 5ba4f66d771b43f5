// What statuses are called on the page, and how good they are.
export type Grade = "good" | "fair" | "bad";

const STATUSES: Record<string, [string, Grade]> = {
  ppp_float: ["PPP", "good"],
  ppp_fixed: ["PPP, integers fixed", "good"],
  ppp_converging: ["PPP, converging", "fair"],
  single_point: ["single point, metres only", "fair"],
  rtk_fixed: ["RTK fixed", "good"],
  rtk_float: ["RTK float", "fair"],
  coasting: ["coasting without GNSS", "fair"],
  aligning: ["finding its attitude", "fair"],
  no_observations: ["no observations", "bad"],
  no_ephemeris: ["no ephemeris", "bad"],
  no_corrections: ["no corrections", "bad"],
  no_base: ["no base station", "bad"],
  no_inertial: ["no IMU samples", "bad"],
  too_few_satellites: ["too few satellites", "bad"],
  rejected_by_quality_control: ["rejected by quality control", "bad"],
  diverged: ["diverged", "bad"],
};

/** Words and grade of a solution's status; one that the page does not know is shown as it is. */
export function statusWords(status: string): [string, Grade] {
  return STATUSES[status] ?? [status.replaceAll("_", " "), "fair"];
}

/** A time of day, with the date where that is not today's. */
export function clock(iso: string): string {
  const time = new Date(iso);
  const today = time.toDateString() === new Date().toDateString();
  return today ? time.toLocaleTimeString() : time.toLocaleString();
}

/** A number with a true minus sign, so that columns of numbers stand still. */
export function number(value: number, digits: number): string {
  return value.toFixed(digits).replace("-", "−");
}
