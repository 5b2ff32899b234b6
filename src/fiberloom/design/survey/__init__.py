"""Hours that a list of targets takes: of one field, or of as many as it fills."""

from fiberloom.design.survey.hours import (
    HoursSettings,
    SurveyTime,
    TiledSurvey,
    larger_than,
    survey_time,
    tiled_survey,
)

__all__ = ["HoursSettings", "SurveyTime", "TiledSurvey", "larger_than", "survey_time", "tiled_survey"]
