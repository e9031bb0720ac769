#pragma once

namespace corvid {

/// The report's style sheet: one set of variables per colour scheme; plot.cpp's classes at the end.
inline constexpr char kReportStyle[] = R"css(
:root{color-scheme:light dark;--page:#f4f4f1;--card:#fdfdfc;--ink:#0b0b0b;--ink2:#52514e;--muted:#77756f;
--grid:#e4e3dd;--axis:#bdbcb2;--edge:#dddcd5;--code:#f1f0ec;--s0:#2a78d6;--s1:#e0581f;--s2:#149a69;--s3:#b77f00;
--good:#149a48;--warn:#e9a10b;--bad:#d03b3b;--idle:#b9b8b1;--alert:#fdf1d3;--alert-ink:#5d4300}
@media (prefers-color-scheme:dark){:root{--page:#0f0f0e;--card:#1a1a19;--ink:#f5f4f0;--ink2:#c3c2b7;
--muted:#94928b;--grid:#2d2d2b;--axis:#4a4a46;--edge:#2f2f2c;--code:#232321;--s0:#4a96ee;--s1:#ee6f3a;
--s2:#22b482;--s3:#d79a13;--good:#2bb158;--warn:#f2b632;--bad:#e65a5a;--idle:#5c5b57;--alert:#3a2e10;
--alert-ink:#f7dc9a}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);font:15px/1.5 system-ui,-apple-system,"Segoe UI",
Roboto,"Helvetica Neue",Arial,sans-serif}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:26px;line-height:1.25;margin:0 0 4px;font-weight:650}
h2{font-size:18px;margin:0 0 12px;font-weight:650}
p{margin:0 0 10px}a{color:var(--s0)}
.sub{color:var(--ink2);overflow-wrap:anywhere}
nav{display:flex;flex-wrap:wrap;gap:4px 16px;margin:14px 0 20px;font-size:14px}
nav a{text-decoration:none}nav a:hover{text-decoration:underline}
.banner{background:var(--alert);color:var(--alert-ink);border-radius:8px;padding:12px 16px;margin:16px 0;
font-weight:600}
.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(200px,44%),1fr));gap:12px;margin:0 0 20px}
.tile,section{background:var(--card);border:1px solid var(--edge);border-radius:10px}
.tile{padding:12px 14px}.tile .name{color:var(--ink2);font-size:13px}
.tile .value{font-size:25px;line-height:1.25;font-weight:650}
.tile .value small{font-size:14px;font-weight:500;color:var(--ink2);white-space:nowrap}
.tile .more{color:var(--muted);font-size:12.5px;line-height:1.4}
section{padding:18px 20px;margin:0 0 20px;overflow:hidden}
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(420px,100%),1fr));gap:18px 26px}
.trio{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(300px,100%),1fr));gap:16px}
figure{margin:0 0 8px;min-width:0}
figcaption{font-size:14px;font-weight:600;margin:0 0 2px}
figcaption span,.note{font-weight:400;color:var(--muted);font-size:13px}
figure img{display:block;width:100%;height:auto;border-radius:6px;background:#16191d}
figure.plot svg{display:block;width:100%;height:auto}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:14px;min-width:50%}
th,td{text-align:left;padding:5px 16px 5px 0;border-bottom:1px solid var(--grid);vertical-align:top}
th{color:var(--ink2);font-weight:600;white-space:nowrap}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
td.wrap{overflow-wrap:anywhere;min-width:110px}
.bar{display:inline-block;height:9px;border-radius:0 3px 3px 0;background:var(--s0);min-width:1px}
pre{background:var(--code);border-radius:6px;padding:12px 14px;overflow:auto;max-height:420px;font:12.5px/1.5
ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;margin:0}
code{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;font-size:.92em;overflow-wrap:anywhere}
ul{margin:0 0 10px;padding-left:20px}.nothing{color:var(--muted)}
.key{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:13px;color:var(--ink2)}
.key i{display:inline-block;width:12px;height:12px;border-radius:3px;margin-right:6px;vertical-align:-1px}
.ramp{display:inline-block;width:90px;height:9px;border-radius:3px;vertical-align:0;margin:0 6px}
.turbo{background:linear-gradient(90deg,#b21c02,#f66c19,#eccf39,#7dff56,#18ddc2,#4294ff,#3e3891)}
.viridis{background:linear-gradient(90deg,#440154,#3b528b,#21918c,#5ec962,#fde725)}
footer{color:var(--muted);font-size:13px}
svg text{font-family:inherit;fill:var(--ink2);font-size:12px}
svg .tick{fill:var(--muted);font-size:11.5px;font-variant-numeric:tabular-nums}
svg .grid{stroke:var(--grid);stroke-width:1}svg .axis{stroke:var(--axis);stroke-width:1}
svg .ground{fill:#16191d}.pictured svg .grid{stroke:#fff;stroke-opacity:.12}
svg polyline,svg line.l0,svg line.l1,svg line.l2,svg line.l3{fill:none;stroke-width:1.8;
stroke-linejoin:round;stroke-linecap:round}
svg .l0{stroke:var(--s0)}svg .l1{stroke:var(--s1)}svg .l2{stroke:var(--s2)}svg .l3{stroke:var(--s3)}
svg .dashed{stroke-dasharray:5 4}
svg .f0{fill:var(--s0)}svg .f1{fill:var(--s1)}svg .f2{fill:var(--s2)}svg .f3{fill:var(--s3)}
.state-starting{fill:var(--idle);background:var(--idle)}
.state-tracking{fill:var(--good);background:var(--good)}
.state-degraded{fill:var(--warn);background:var(--warn)}
.state-lost{fill:var(--bad);background:var(--bad)}
@media print{body{background:#fff}section,.tile{break-inside:avoid}pre{max-height:none}}
)css";

}  // namespace corvid
