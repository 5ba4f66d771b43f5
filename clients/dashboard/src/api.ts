// The REST calls that the page makes, and the forms of their answers (openapi/openapi.json has them all).
export interface Status {
  station: string;
  state: "waiting" | "receiving" | "silent";
  reason: string;
  solution_status: string | null;
  n_satellites: number;
  last_epoch: string | null;
}

export interface Station {
  station: string;
  name: string;
  mode: string;
  status: Status;
}

export interface Alert {
  alert_id: string;
  station: string;
  severity: "warning" | "alarm";
  state: "active" | "acknowledged" | "cleared";
  text: string;
  onset: string;
  acknowledged_by?: string;
}

export interface Attitude {
  station: string;
  roll_deg: number | null;
  pitch_deg: number | null;
  heading_deg: number | null;
  sigma_roll_deg: number | null;
  sigma_pitch_deg: number | null;
  sigma_heading_deg: number | null;
}

export interface Explanation {
  epochs: number;
  findings: { text: string; advice: string; share: number }[];
}

interface Page<T> {
  items: T[];
  next: string | null;
}

async function get<T>(address: string): Promise<T> {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return (await answer.json()) as T;
}

async function all<T>(path: string): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | null = null;
  do {
    const page: Page<T> = await get(cursor ? `${path}&cursor=${encodeURIComponent(cursor)}` : path);
    items.push(...page.items);
    cursor = page.next;
  } while (cursor);
  return items;
}

/** Stations with a receiver; streams of corrections have no motion to show. */
export async function listStations(): Promise<Station[]> {
  return (await all<Station>("v1/stations?limit=500")).filter((s) => s.mode !== "corrections");
}

/** Alerts that are not over, seen or not. */
export async function listOpenAlerts(): Promise<Alert[]> {
  const states = ["active", "acknowledged"].map((state) => all<Alert>(`v1/alerts?limit=100&state=${state}`));
  return (await Promise.all(states)).flat();
}

/** Say that an alert is seen. */
export async function acknowledge(alertId: string, by: string): Promise<Alert> {
  const address = `v1/alerts/${encodeURIComponent(alertId)}/acknowledge`;
  const headers = { "Content-Type": "application/json" };
  const answer = await fetch(address, { method: "POST", headers, body: JSON.stringify({ by }) });
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return (await answer.json()) as Alert;
}

/** Why a station's last epochs have no solution, or a poor one. */
export const explain = (station: string): Promise<Explanation> =>
  get(`v1/stations/${encodeURIComponent(station)}/explain`);
