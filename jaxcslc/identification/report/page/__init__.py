from ._data import WritableReport as WritableReport, report_data as report_data
from ._page import report_page as report_page
from ._quality import fit_quality as fit_quality
from ._summary import summary_text as summary_text
